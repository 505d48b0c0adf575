"""What a trial asks for, and what it makes of a recording."""

import pytest
import torch

import torchds
import torchds.dmp
from tests.motions import Short
from torchds.errors import InvalidArgumentError
from torchds.sessions import Layout, Trial
from torchds.sessions.tables import Recorded
from torchds.sessions.trial import TAKEN

PLANE = Layout(("x [m]", "y [m]"))


def test_a_task_says_motion_columns_and_costs(randn):
    task = Short()
    trial, policy = Trial.of(task), task.policy()
    assert trial.layout.position == ("x1 [1]", "x2 [1]")
    path = torchds.rollout(policy, *task.motion())
    asked = trial.reference(policy)
    assert (
        torch.equal(asked.x, path.x) and torch.equal(asked.v, path.v) and asked.stiffness.shape == (path.v.shape[0], 0)
    )
    tried = policy.expand(2)
    measured = path.x + 0.1 * randn(2, *path.x.shape)
    terms = trial.terms(tried, Recorded(measured, measured[:, 1:, :0]), torch.tensor([True, False]))
    expected = task.cost_terms(torchds.Rollout(**{**vars(path), "x": measured, "v": measured.diff(dim=1) / trial.dt}))
    for name, value in terms.items():
        torch.testing.assert_close(value[0], expected[name][0])
        assert value[1] == torch.inf


def test_what_the_policy_does_not_see_is_integrated(random_policy):
    policy = random_policy(D=2, O=3, Q=1)
    layout = Layout(("x [m]", "y [m]", "angle [rad]"), stiffness=("s [N/m]",))
    asked = Trial([0.1, 0.2, 0.5], 10, 0.1, layout).reference(policy)
    assert asked.x.shape == (11, 3) and asked.stiffness.shape == (10, 1)
    torch.testing.assert_close(asked.x[:, 2], 0.5 + torch.cat([torch.zeros(1), 0.1 * asked.v[:, 2].cumsum(0)]))
    assert Trial([0.1, 0.2], 10, 0.1, layout).reference(policy).x[0, 2] == 0


def test_what_is_out_of_reach_is_known(random_policy):
    trial = Trial([0.1, 0.2], 10, 0.1, PLANE, reaches=lambda x: x[..., 0] < 100)
    asked = trial.reference(random_policy(batch=(3,)).requires_grad_(False))
    assert trial.possible(asked).all()
    x = asked.x.clone()
    x[1, 5, 0], x[2, 3, 1] = 200.0, torch.nan
    assert trial.possible(asked._replace(x=x)).tolist() == [True, False, False]
    wall = torchds.Walls(torch.tensor([[[0.5, -1.0], [0.5, 1.0]]], dtype=torch.float64))
    behind = torch.stack([torch.linspace(0, 1, 11, dtype=torch.float64), torch.zeros(11)], -1)
    trial, x = Trial([0.0, 0.0], 10, 0.1, PLANE, stop=wall), torch.stack([0.4 * behind, behind, 0.4 * behind])
    assert trial.possible(asked._replace(x=x)).tolist() == [True, False, True]


def test_bad_arguments_are_refused(random_policy, randn):
    with pytest.raises(
        InvalidArgumentError, match=r"one start .* got shape \(2, 2\); tasks of several starts are several"
    ):
        Trial(randn(2, 2), 10, 0.1, PLANE)
    with pytest.raises(InvalidArgumentError, match="n_steps has to be at least 1"):
        Trial(randn(2), 0, 0.1, PLANE)
    with pytest.raises(InvalidArgumentError, match="dt has to be positive"):
        Trial(randn(2), 10, -0.1, PLANE)
    trial = Trial(randn(2), 10, 0.1, PLANE)
    with pytest.raises(
        InvalidArgumentError, match="has to have 3 positions and 1 columns of stiffness, as the policy does, got 2"
    ):
        trial.reference(random_policy(D=2, O=3, Q=1))
    with pytest.raises(
        InvalidArgumentError, match="x0 has to have the 2 inputs of the policy, or all 2 positions, got 1"
    ):
        Trial(randn(1), 10, 0.1, PLANE).reference(random_policy())
    with pytest.raises(InvalidArgumentError, match="got a DMP, which makes its roll-outs itself"):
        trial.reference(torchds.dmp.DMP(randn(5, 2), randn(2), 1.0))
    recorded = Recorded(randn(1, 11, 2), randn(1, 10, 0))
    for name in (*TAKEN, "goal, end"):
        named = Trial(
            randn(2), 10, 0.1, PLANE, lambda path, name=name: {"end": path.x[..., -1, 0], name: path.x[..., 0, 0]}
        )
        with pytest.raises(InvalidArgumentError, match=f"names without commas .*, got '{name}'; give them others"):
            named.terms(random_policy(batch=(1,)), recorded, torch.tensor([True]))
    with pytest.raises(
        InvalidArgumentError, match=r"no cost_terms.* give costs in costs\.csv, or make the trial with cost_terms="
    ):
        trial.terms(random_policy(batch=(1,)), recorded, torch.tensor([True]))
