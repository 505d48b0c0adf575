"""The arch that both force fields share: its curve, and three motions that pass beside it."""

import numpy as np
import pytest
import torch

import tasks
from tasks.force_fields.base import arch, arch_demonstrations
from tasks.trials import Trials
from torchds.errors import InvalidArgumentError
from torchds.passive import PassiveState
from torchds.plants import PointMassState
from train.learning.learner import Learner
from train.options import options_for


def test_the_arch_leads_from_its_start_to_the_origin_in_one_bow():
    s = torch.linspace(0, 1, 101, dtype=torch.float64)
    x = arch(s).numpy()
    np.testing.assert_allclose(x[[0, -1]], [[-12, 0], [0, 0]], atol=1e-12)
    assert (np.diff(x[:, 0]) > 0).all() and (x[1:-1, 1] > 0).all()
    np.testing.assert_allclose(x[50], [-6, 4], atol=1e-12)


def test_the_demonstrations_pass_beside_the_arch_by_the_bias_half_way_and_end_slowly():
    for bias in (0.0, 0.6):
        demos = arch_demonstrations(bias)
        assert len(demos) == 3 and all((len(d.x) - 1) * d.dt == 14.0 for d in demos)
        mean = torch.stack([d.x for d in demos]).mean(0).numpy()
        curve = arch(torch.linspace(0, 1, 4001, dtype=torch.float64)).numpy()
        away = np.linalg.norm(mean[:, None] - curve, axis=-1).min(1)
        assert abs(away.max() - bias) < 0.05
        for d in demos:
            assert float(d.x[-1].norm()) < 1e-6
            assert float(d.v[-1].norm()) < 0.2 * float(d.v[0].norm())


# ---------------------------------------------------------------------- open loop, closed loop, passive


@pytest.mark.parametrize("execution", ["open", "closed", "passive"])
@pytest.mark.slow
def test_each_execution_is_that_roll_out(execution):
    task = tasks.make("half_plane_force", execution=execution)
    task.motion = lambda: type(task).motion(task)._replace(n_steps=12)
    policy = task.policy().requires_grad_(False)
    path = task.rollout(policy)
    seen = path.reference if execution == "open" else path.x
    torch.testing.assert_close(path.inputs, seen[..., :-1, :], rtol=0, atol=0)
    assert isinstance(path.plant, PassiveState if execution == "passive" else PointMassState)
    assert float(path.plant.stiffness[..., 1:, :].min()) > 1  # what the policy asks for is what is applied, and costs
    assert set(task.cost_terms(path)) == {"via_points", "goal", "acceleration", "stiffness"}
    assert ("stiffness/injected_energy" in task.diagnostics(path)) == (execution != "passive")
    trials = Trials(task, 1)
    while not trials.done:
        trials.step(torch.zeros(1, trials.n_actions, dtype=torch.float64))
    torch.testing.assert_close(trials.path().x[0], path.x, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("execution", ["closed", "passive"])
def test_learning_works_in_closed_loop(execution):
    learner = Learner(options_for("half_plane_force", runs=4, updates=12, execution=execution))
    learner.learn()
    cost = torch.tensor(learner.history.cost)
    assert bool((cost[-1] < 0.8 * cost[0]).all())


def test_an_execution_that_is_none_is_refused():
    with pytest.raises(InvalidArgumentError, match="execution has to be 'open', 'closed' or 'passive', got 'shut'"):
        tasks.make("divergent_field", execution="shut")


# ---------------------------------------------------------------------- trials with noise


def noisy(seed=0, **options):
    task = tasks.make("divergent_field", sensor_noise=0.05, pushes=5.0, **options)
    task.motion = lambda: type(task).motion(task)._replace(n_steps=30)
    task.chance = torch.Generator().manual_seed(seed)
    return task


@pytest.mark.parametrize("execution", ["open", "closed"])
def test_trials_are_noisy_where_they_are_learned_from_alone_and_each_in_its_own_way(execution):
    task = noisy(execution=execution)
    policy = task.policy().expand(3).requires_grad_(False)
    first, second = task.rollout(policy).x, task.rollout(policy).x
    again = noisy(execution=execution).rollout(policy).x
    assert torch.equal(first, again) and not torch.equal(first, second)
    assert not torch.equal(first[0], first[1])  # three times the same policy
    task.chance = None
    still = task.rollout(policy).x
    assert torch.equal(still[0], still[1]) and torch.equal(still, task.rollout(policy).x)


def test_a_run_with_noisy_trials_counts_what_it_costs_without_noise():
    options = options_for("half_plane_force", runs=2, updates=3, sensor_noise=0.05, pushes=5.0)
    learner = Learner(options).learn()
    assert learner.task.chance is None
    torch.testing.assert_close(torch.tensor(learner.history.cost[-1]), sum(learner.evaluate().values()).float())
    calm = Learner(options_for("half_plane_force", runs=2, updates=3)).learn()
    assert calm.history.cost[0] == learner.history.cost[0] and calm.history.cost[-1] != learner.history.cost[-1]


@pytest.mark.parametrize("name", ["sensor_noise", "pushes"])
def test_negative_noise_is_refused(name):
    with pytest.raises(InvalidArgumentError, match=f"{name} has to be finite"):
        tasks.make("divergent_field", **{name: -1.0})
