"""The digging task: Eq. 35 to 38 by hand, trials that fail, beds that are met again after a resume."""

import copy

import numpy as np
import pytest
import torch

import tasks
import tasks.digging.task as task_module
from torchds import Demonstrations
from torchds.errors import InvalidArgumentError, TorchdsError, UnknownNameError
from torchds.exploration import Homogeneous
from torchds.optim import PIBB
from torchds.sharing import Share, trying
from train.learning.learner import Learner
from train.options import options_for

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")


SHORT = {"grains": "coarse", "seconds": 1.0}


@pytest.fixture(scope="module")
def trial():
    """A task, two policies and their trial: long enough to dig."""
    task = tasks.make("lwr_digging", initial_stiffness=200.0, grains="coarse", seconds=3.0)
    policy = task.policy().expand(2)
    with torch.no_grad():
        policy.stiffness_b[1] += 400.0
        policy.stiffness_A[1] += 900.0
    return task, policy, task.rollout(policy)


@pytest.mark.slow
def test_the_reference_is_what_a_loop_over_eq_36_to_38_gives(trial):
    task, policy, _ = trial
    _, reference, stiffness = task.reference(policy)
    assert task.policy().stiffness(task.start[:2]).item() == pytest.approx(200.0)
    for r in range(2):
        A, b, slopes, offsets = (
            getattr(policy, name)[r].detach().numpy() for name in ("A", "b", "stiffness_A", "stiffness_b")
        )
        x, angle = task.start[:2].numpy(), float(task.start[2])
        for i in range(300):
            h = policy.gating(torch.from_numpy(x)).numpy()
            y = sum(h[k] * (A[k] @ x + b[k]) for k in range(4))
            s = sum(h[k] * (slopes[k] @ x + offsets[k]) for k in range(4))[0]
            assert stiffness[r, i].item() == pytest.approx(min(max(s, 50.0), 700.0), rel=1e-9)
            x, angle = x + 0.004 * y[:2], angle + 0.004 * y[2]
            np.testing.assert_allclose(reference[r, i + 1].numpy(), [*x, angle], rtol=0, atol=1e-9)
    assert stiffness.max() == 700.0


def test_the_cost_is_eq_35_summed_at_500_hz(trial):
    task, _, path = trial
    done, terms = path.plant, task.cost_terms(path)
    assert not done.failed.any()
    assert done.force[..., 2].abs().max() > 2.0  # it has dug
    goal = np.mean([d.x[-1].numpy() for d in task.demonstrations], 0)
    for r in range(2):
        pose, F, s, w = (v[r].numpy() for v in (done.pose, done.force, done.stiffness, done.load))
        assert terms["gravel"][r].item() == pytest.approx(3.5 - w)
        assert terms["goal"][r].item() == pytest.approx(10 * np.sum((pose[-1] - goal) ** 2))
        force = stiffness = acceleration = 0.0
        for i in range(len(s)):
            lifted = all(pose[j, 1] >= 0.16 for j in range(i + 1, len(pose)))
            corrected = F[i] - (np.array([0.0, 0.0, w]) if lifted else 0.0)
            force += 2 * 1e-6 * corrected @ corrected
            stiffness += 2 * 5e-7 * s[i]
            if i > 0:  # two steps of 2 ms, with half of the change in each
                half = 0.5 * ((pose[i + 1] - pose[i]) - (pose[i] - pose[i - 1])) / 0.004
                acceleration += 2 * 1e-4 * half @ half
        assert terms["force"][r].item() == pytest.approx(force)
        assert terms["stiffness"][r].item() == pytest.approx(stiffness)
        assert terms["acceleration"][r].item() == pytest.approx(acceleration)
    torch.testing.assert_close(task.step_costs(path).sum(-1), task.cost(path))


@pytest.mark.slow
def test_the_demonstrations_are_imitated():
    task = tasks.make("lwr_digging")
    assert [d.x.shape[-1] for d in task.demonstrations] == [3] * 5
    _, reference, _ = task.reference(task.policy())
    at_lowest = reference[reference[:, 1].argmin()]
    lowest = torch.stack([d.x[d.x[:, 1].argmin()] for d in task.demonstrations])
    assert (at_lowest[:2] - lowest[:, :2].mean(0)).abs().max() < 0.015  # m
    assert (reference[-1, :2] - task.goal[:2]).norm() < 0.02
    assert (reference[-1, 2] - task.goal[2]).abs() < 0.15  # rad


@pytest.mark.slow
def test_a_users_recordings_are_learned_from(tmp_path):
    for i in range(2):
        t = np.linspace(0, 1, 60)[:, None]
        pose = (1 - t) * [0.6, 0.2, -0.5] + t * [0.8, 0.1 + 0.02 * i, 0.2]
        pose[:, 1] -= 0.05 * np.sin(np.pi * t[:, 0])
        np.savetxt(
            tmp_path / f"{i}.csv",
            np.column_stack([0.1 * np.arange(60), pose]),
            "%.6f",
            ",",
            header="time,x,z,angle",
            comments="",
        )
    task = tasks.make("lwr_digging", demonstrations=tmp_path, **SHORT)
    torch.testing.assert_close(task.start, torch.tensor([0.6, 0.2, -0.5], dtype=torch.float64))
    torch.testing.assert_close(task.goal, torch.tensor([0.8, 0.11, 0.2], dtype=torch.float64))
    assert task.policy().A.shape == (4, 3, 2)


@pytest.mark.slow
def test_what_the_arm_cannot_do_fails_and_leaves_the_others_alone():
    task, again = (tasks.make("lwr_digging", **SHORT) for _ in range(2))
    good, bad = task.policy().expand(3), task.policy().expand(3)
    with torch.no_grad():
        bad.b[0, :, 0] += 5.0  # m/s, away
        bad.A[2] += 1e9
    path = task.rollout(bad)
    cost = task.cost(path)
    assert path.plant.failed.tolist() == [True, False, True]
    assert cost.isinf().tolist() == [True, False, True]
    assert cost[1] == again.cost(again.rollout(good))[1]


@pytest.mark.slow
def test_failed_trials_have_no_weight_and_are_counted():
    task = tasks.make("lwr_digging", **SHORT)
    policy = task.policy()
    optim = PIBB(policy.parameters(), Homogeneous(policy, 0.004, mean_stiffness=30.0), n_rollouts=3, elite="nominal")

    def closure():
        with torch.no_grad():
            policy.b[1, :, 0] += 5.0
        return task.cost(task.rollout(policy))

    optim.step(closure)
    assert optim.last.failed.tolist() == [False, True, False]
    assert optim.last.weights[1] == 0.0


@pytest.mark.slow
def test_a_run_that_is_resumed_meets_the_same_beds():
    options = options_for("lwr_digging", grains="coarse", seconds=1.0, updates=2, rollouts=2, threads=1)
    whole = Learner(options).learn()
    first = Learner(options)
    first.start()
    first.update()
    second = Learner(options)
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    second.update()
    assert second.history.cost == whole.history.cost
    assert torch.equal(second.policy.pack(), whole.policy.pack())


@pytest.mark.slow
def test_the_number_of_threads_changes_no_bit_of_the_cost():
    costs = []
    for threads in (1, 2):
        task = tasks.make("lwr_digging", initial_stiffness=300.0, grains="coarse", seconds=2.0, threads=threads)
        costs.append(task.cost(task.rollout(task.policy().expand(3))))
    assert torch.equal(*costs)
    assert len(set(costs[0].tolist())) == 3  # three beds


@pytest.mark.slow
def test_runs_and_roll_outs_are_batch_dimensions():
    task = tasks.make("lwr_digging", **SHORT)
    path = task.rollout(task.policy().expand(2, 3))
    assert path.x.shape == (2, 3, 251, 3)
    assert {name: value.shape for name, value in task.cost_terms(path).items()} == dict.fromkeys(
        ("gravel", "goal", "force", "stiffness", "acceleration"), (2, 3)
    )
    assert task.trials == 6


def test_bad_options_are_refused_before_anything_is_built():
    for options, message in (
        ({"initial_stiffness": 20.0}, r"within \[50, 700\] N/m, got 20"),
        ({"grains": "sand"}, "'fine' or 'coarse', got 'sand'"),
        ({"seconds": 0.1}, "seconds has to be above 0.5"),
        ({"threads": 0}, "threads at least 1"),
        ({"convention": "released"}, "has to be 'paper'"),
        ({"demonstrations": Demonstrations([torch.rand(9, 2)], dt=0.1)}, "three dimensions"),
    ):
        with pytest.raises(InvalidArgumentError, match=message):
            tasks.make("lwr_digging", **options)
    with pytest.raises(UnknownNameError, match="lwr_digging"):
        tasks.make("digging")


def test_shares_of_a_trial_meet_the_beds_of_one_process(monkeypatch):
    met = []

    def dig(worlds, reference, stiffness, seeds, progress):
        met.append(seeds)
        raise TorchdsError("dug")

    monkeypatch.setattr(task_module, "dig", dig)
    for share in (None, Share(0, 2, 5), Share(2, 5, 5)):
        task = tasks.make("lwr_digging", seed=3, **SHORT)
        task.trials, task.worlds = 7, lambda n: None
        n = 5 if share is None else share.last - share.first
        with trying(share), pytest.raises(TorchdsError, match="dug"):
            task.execute(task.start.expand(n, 2, 11, 3), torch.full((n, 2, 10), 300.0, dtype=torch.float64))
        assert task.trials == 7 + 10
    assert met[0] == [3_000_007 + i for i in range(10)] == met[1] + met[2]
