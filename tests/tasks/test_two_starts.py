"""Two starts and two sets of via-points: Eq. 40 in numpy, and what is learned."""

import numpy as np
import pytest
import torch

import tasks
from torchds.errors import InvalidArgumentError
from torchds.exploration import Homogeneous
from torchds.optim import PI2, PIBB, InverseIteration

LEFT = [(-10.0, 5.0), (-5.5, 9.5), (-2.0, 5.0)]
RIGHT = [(8.0, 4.5), (5.5, 10.0), (3.0, 4.5)]


def vary(policy, n, size):
    """A batch of n policies near `policy`."""
    theta = policy.pack().detach()
    generator = torch.Generator().manual_seed(9)
    return policy.unpack(theta + size * torch.randn(n, len(theta), generator=generator, dtype=torch.float64))


def via(x, points):
    """Σ_l min_{j ≥ 1} |x_l − x_j|² in loops."""
    return sum(min(((np.array(p) - x_j) ** 2).sum() for x_j in x[1:]) for p in points)


# ------------------------------------------------------------------ as printed


@pytest.mark.slow
def test_cost_terms_are_those_of_equation_40():
    task = tasks.make("two_starts")
    policy = vary(task.policy(), 3, 0.05)
    with torch.no_grad():
        path, terms = task.evaluate(policy)
    assert path.x.shape == (3, 2, 201, 2)
    assert path.x[:, :, 0].unique(dim=0).tolist() == [[[-11.0, -0.5], [11.0, -0.5]]]
    assert set(terms) == {"via_points", "goal", "acceleration", "control"}
    for r in range(3):
        expected = dict.fromkeys(terms, 0.0)
        for x, v in zip(path.x[r].numpy(), path.v[r].numpy(), strict=True):
            expected["via_points"] += min(via(x, LEFT), via(x, RIGHT))
            expected["goal"] += (x[-1] ** 2).sum()
            expected["acceleration"] += 2e-4 * sum(np.linalg.norm(v[j] - v[j - 1]) for j in range(1, len(v)))
        deviation = (policy.pack()[r] - task.policy().pack()).detach().numpy()
        expected["control"] = 2 * 200 * 0.5 * 5e-4 * (deviation**2).sum()  # of both trajectories
        for name, value in terms.items():
            assert value[r].item() == pytest.approx(expected[name], rel=1e-10), name


@pytest.mark.slow
def test_each_trajectory_takes_the_cheaper_set():
    """Also where both take the same one: the minimum is of each trajectory, not of the pair."""
    task = tasks.make("two_starts")
    path = task.rollout(task.policy().expand(1))
    own = task.cost_terms(path)["via_points"]
    both_left = torch.stack([path.x[:, 0], path.x[:, 0]], 1)
    twice = task.cost_terms(type(path)(**{**vars(path), "x": both_left}))["via_points"]
    x = path.x[0].detach().numpy()
    assert own.item() == pytest.approx(via(x[0], LEFT) + via(x[1], RIGHT), rel=1e-10)
    assert twice.item() == pytest.approx(2 * via(x[0], LEFT), rel=1e-10)


@pytest.mark.slow
def test_the_imitated_policy_is_alike_on_both_sides_and_costs_about_6_15():
    task = tasks.make("two_starts")
    assert task.policy().n_components == 6
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    assert tasks.base.total(terms.values()).item() == pytest.approx(6.15, abs=0.1)
    assert terms["control"] == 0
    assert asymmetry(path).item() < 1.0


def asymmetry(path):
    """Mean distance between the right path and the mirrored left path."""
    mirrored = path.x[..., 0, :, :] * torch.tensor([-1.0, 1.0], dtype=torch.float64)
    return (path.x[..., 1, :, :] - mirrored).norm(dim=-1).mean(-1)


def test_the_scene_shows_what_the_task_is_about():
    scene = tasks.make("two_starts").scene()
    assert scene.starts.tolist() == [[-11.0, -0.5], [11.0, -0.5]]
    assert scene.goal.tolist() == [0, 0]
    assert [points.tolist() for points in scene.via_points.values()] == [[list(p) for p in s] for s in (LEFT, RIGHT)]


@pytest.mark.slow
def test_with_the_papers_settings_20_runs_learn_and_the_two_sides_part():
    """Section 3.3 and appendix A.2: 200 updates of 20 roll-outs."""
    task, n = tasks.make("two_starts"), 20
    search = task.search
    assert (search.n_updates, search.n_rollouts, search.control_weight, search.mean_speed) == (200, 20, 5e-4, 0.1)
    policy = task.policy().expand(n)
    optim = PIBB(
        policy.parameters(),
        search.homogeneous(policy, search.mean_speed),
        search.n_rollouts,
        temperature=search.temperature,
        control_weight=search.control_weight,
        generator=torch.Generator().manual_seed(0),
    )
    decay = torch.optim.lr_scheduler.LambdaLR(optim, InverseIteration())
    with torch.no_grad():
        before = asymmetry(task.rollout(task.policy()))
    for _ in range(search.n_updates):
        optim.step(lambda: task.cost(task.rollout(policy)))
        decay.step()
    with torch.no_grad():
        path, terms = task.evaluate(policy)
    assert tasks.base.total(terms.values()).median() < 1.1  # from 6.15
    assert (asymmetry(path).median() / before).item() > 1.4
    assert (asymmetry(path) > before).all()


# ------------------------------------------------------------------ refusals


@pytest.mark.slow
def test_pi2_is_told_that_it_cannot_learn_from_two_starts():
    task = tasks.make("two_starts")
    policy = task.policy()
    optim = PI2(policy.parameters(), Homogeneous(policy), n_rollouts=2)
    with pytest.raises(InvalidArgumentError, match=r"PI2 needs one roll-out from one start.*of \(2, 2, 200\) steps"):
        optim.step(lambda: task.step_costs(task.rollout(policy)))
