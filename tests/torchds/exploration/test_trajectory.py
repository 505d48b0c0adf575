"""Noise along the motion against its printed formula, against sampled motions, and as part of an optimizer."""

import copy
import math
import re

import numpy as np
import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.testing import assert_close

import torchds
from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Homogeneous, TrajectorySpace, trajectory
from torchds.optim import PIBB, ExponentialDecay
from torchds.sensitivity import sensitivity

MEANS = np.array([[-0.9, 0.6], [0.5, -0.4]])
COVARIANCES = np.array([[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]])
T, DT = 15, 0.1
START = torch.tensor([-1.2, 0.9], dtype=torch.float64)
STARTS = torch.tensor([[-1.2, 0.9], [-0.8, 0.2], [0.4, -0.6]], dtype=torch.float64)
GOAL = torch.tensor([0.8, -0.3], dtype=torch.float64)


def make_policy(dtype=torch.float64, Q=0):
    values = {
        "priors": [0.4, 0.6],
        "means": MEANS,
        "covariances": COVARIANCES,
        "A": [[[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]],
        "b": [[0.3, -0.4], [0.5, -0.1]],
    }
    if Q:
        values |= {"stiffness_A": [[[0.3, -0.2]] * Q] * 2, "stiffness_b": [[2.0] * Q] * 2}
    return GMRPolicy(**{name: torch.as_tensor(value, dtype=dtype) for name, value in values.items()})


def make_batch(n):
    """Policies that differ."""
    policy = make_policy()
    generator = torch.Generator().manual_seed(3)
    return policy.unpack(policy.pack() + 0.3 * torch.randn(n, 12, generator=generator, dtype=torch.float64))


def make(policy=None, x0=START, n_steps=T, spread=0.5, **options):
    return TrajectorySpace(make_policy() if policy is None else policy, x0, n_steps, DT, spread, **options)


def draw(exploration, n, seed=0):
    """The noise of n roll-outs, `(n, *batch, P)` in the order of `GMRPolicy.pack`."""
    policy = exploration.policy
    generator = torch.Generator().manual_seed(seed)
    parameters = list(policy.parameters())
    normals = [torch.randn(n, *p.shape, generator=generator, dtype=torch.float64).to(p) for p in parameters]
    noise = dict(zip(parameters, exploration(parameters, normals), strict=True))
    return policy.pack(lambda p: noise[p])


# ------------------------------------------------------------------ the formula, in numpy


class Path(nn.Module):
    def __init__(self, policy, x0, n_steps):
        super().__init__()
        self.policy, self.x0, self.n_steps = policy, x0, n_steps

    def forward(self):
        return rollout(self.policy, self.x0, self.n_steps, DT).x[..., 1:, :]


class Rows(nn.Module):
    def __init__(self, policy):
        super().__init__()
        self.policy = policy

    def forward(self, x):
        return self.policy.stiffness(x)


def jacobian(policy, x0=START, n_steps=T):
    """J (points T D, P) by autograd."""
    path = Path(policy, x0, n_steps)

    def motion(theta):
        return functional_call(path, {f"policy.{name}": v for name, v in policy.split(theta).items()}, ()).flatten()

    return torch.func.jacrev(motion)(policy.pack().detach()).numpy()


def homogeneous_std(mean_speed):
    """Eq. 15-18 at the two Gaussians, with sqrt(μ² + Σ) in place of |μ|, in the order of Eq. 10-11."""
    share = math.sqrt(2 * mean_speed**2 / (3 * math.pi))
    size = np.sqrt(MEANS**2 + np.diagonal(COVARIANCES, axis1=1, axis2=2))
    return np.concatenate([share / np.array([m[0], m[1], m[0], m[1], 1, 1]) for m in size])


def metric(policy, x0=START, n_steps=T):
    """JᵀJ/T, the mean over all times and starts."""
    J = jacobian(policy, x0, n_steps)
    return J.T @ J / (len(J) / 2)


@pytest.mark.parametrize("x0", [START, STARTS, STARTS[:2, None]], ids=["one start", "three", "two by one"])
@pytest.mark.parametrize(("spread", "widening", "mean_speed"), [(0.5, 3.0, 0.1), (0.05, 1.0, 0.3), (20.0, 10.0, 0.1)])
def test_without_damping_the_covariance_is_the_printed_one(x0, spread, widening, mean_speed):
    exploration = make(x0=x0, spread=spread, widening=widening, mean_speed=mean_speed, damping=0.0)
    D = np.diag((widening * homogeneous_std(mean_speed)) ** 2)
    expected = np.linalg.inv(metric(exploration.policy, x0) / spread**2 + np.linalg.inv(D))
    np.testing.assert_allclose(exploration.covariance, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    assert_close(exploration.factor @ exploration.factor.mT, exploration.covariance, rtol=0, atol=0)


@pytest.mark.parametrize("x0", [START, STARTS], ids=["one start", "three"])
@pytest.mark.parametrize("damping", [1e-4, 1e-2, 10.0])
def test_damping_multiplies_the_variance_of_each_eigenvector(x0, damping):
    exploration = make(x0=x0, spread=0.3, widening=2.0, damping=damping)
    root = np.diag(homogeneous_std(0.1))
    values, V = np.linalg.eigh(root @ metric(exploration.policy, x0) @ root)
    variances = 1 / (values / 0.3**2 + 1 / 2.0**2) * values / (values + damping * values.max())
    expected = root @ V @ np.diag(variances) @ V.T @ root
    np.testing.assert_allclose(exploration.covariance, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    undamped = make(x0=x0, spread=0.3, widening=2.0, damping=0.0).covariance
    assert torch.linalg.eigvalsh(undamped - exploration.covariance).min() > -1e-15  # less noise in every direction


def test_more_starts_that_are_alike_change_nothing():
    """The spread is a mean over the starts, not a sum."""
    assert_close(make(x0=START.expand(5, 2)).covariance, make().covariance, rtol=1e-10, atol=1e-14)


def test_a_direction_that_the_motion_does_not_feel_is_left_alone_with_damping_and_free_without():
    """Two steps in the plane are four numbers: eight of the twelve directions do nothing."""
    felt = make(n_steps=2)
    scale = torch.from_numpy(np.outer(homogeneous_std(0.1), homogeneous_std(0.1)))
    values = torch.linalg.eigvalsh(felt.covariance / scale)
    assert values[:8].abs().max() < 1e-9
    assert values[8:].min() > 1e-4
    values = torch.linalg.eigvalsh(make(n_steps=2, damping=0.0).covariance / scale)
    assert_close(values[4:], torch.full((8,), 9.0, dtype=torch.float64), rtol=1e-9, atol=0)  # widening²


def test_a_wide_spread_leaves_the_homogeneous_noise_and_a_narrow_one_moves_the_motion_by_the_spread():
    wide = make(spread=1e6, widening=2.0, damping=0.0).covariance
    expected = np.diag((2.0 * homogeneous_std(0.1)) ** 2)
    np.testing.assert_allclose(wide, expected, rtol=0, atol=1e-9 * expected.max())
    narrow = make(n_steps=2, spread=1e-4, widening=1e3, damping=0.0)
    moved = np.trace(metric(narrow.policy, START, 2) @ narrow.covariance.numpy())
    assert moved == pytest.approx(4 * 1e-4**2, rel=1e-4)  # four directions are felt, each of them by the spread


@pytest.mark.parametrize("x0", [START, STARTS], ids=["one start", "three"])
@pytest.mark.parametrize("options", [{}, {"damping": 0.0, "widening": 1.0}, {"spread": 0.05, "damping": 1e-2}])
@pytest.mark.slow
def test_the_motion_is_displaced_as_much_as_the_covariance_says(x0, options):
    """Mean-square displacement under small noise against tr(JᵀJ C)/T."""
    n, small = 4000, 1e-3
    exploration = make(x0=x0, **options)
    policy, theta = exploration.policy, exploration.policy.pack().detach()
    expected = np.trace(metric(policy, x0) @ exploration.covariance.numpy())
    noise = draw(exploration, n, seed=1)
    with torch.no_grad():
        before = rollout(policy, x0, T, DT).x[..., 1:, :]
        after = rollout(copy.deepcopy(policy).unpack(theta + small * noise), x0, T, DT).x[..., 1:, :]
    squares = ((after - before) / small).square().sum(-1).flatten(1).mean(-1)  # (n,) mean over starts and times
    # Four standard errors, 5 % or so; what is not linear in the noise is a thousandth of that.
    error = squares.std() / math.sqrt(n)
    assert error < 0.02 * expected
    assert abs(squares.mean() - expected) < 4 * error


def test_the_noise_is_the_factor_times_the_normals():
    exploration = make()
    parameters = list(exploration.policy.parameters())
    for i in range(12):  # one unit vector after the other
        unit = exploration.policy.split(torch.eye(12, dtype=torch.float64)[i])
        noise = exploration(parameters, [unit["A"][None], unit["b"][None]])
        expected = exploration.policy.split(exploration.factor[:, i])
        for epsilon, name in zip(noise, ("A", "b"), strict=True):
            assert_close(epsilon[0], expected[name], rtol=1e-14, atol=1e-16)
    swapped = exploration(parameters[::-1], [unit["b"][None], unit["A"][None]])
    assert_close(swapped[1], noise[0], rtol=0, atol=0)


# ------------------------------------------------------------------ batches, fallback


@pytest.mark.parametrize("x0", [START, STARTS], ids=["one start", "three"])
@pytest.mark.slow
def test_twenty_runs_in_a_batch_equal_single_ones(x0):
    runs = make_batch(20)
    together = make(runs, x0)
    noise = draw(together, 3, seed=5)
    generator = torch.Generator().manual_seed(5)
    A, b = (torch.randn(3, *p.shape, generator=generator, dtype=torch.float64) for p in runs.parameters())
    z = torch.cat([A.flatten(-2), b], -1).flatten(-2)  # (3, 20, P)
    assert together.factor.shape == (20, 12, 12)
    for r in range(20):
        single = make(runs[r], x0)
        assert_close(together.covariance[r], single.covariance, rtol=1e-9, atol=1e-13)
        # An eigenvector has no sign of its own.
        assert_close(together.factor[r].abs(), single.factor.abs(), rtol=1e-6, atol=1e-6)
        assert_close(noise[:, r], z[:, r] @ together.factor[r].mT, rtol=1e-12, atol=1e-14)


def test_a_motion_that_diverges_falls_back_to_homogeneous_noise_and_its_neighbours_do_not_notice():
    runs = make_batch(3)
    alone = make(runs[2]).covariance
    with torch.no_grad():
        runs.A[0] = 1e200 * torch.eye(2)
        runs.A[1] = torch.nan
    exploration = make(runs, n_steps=T)
    expected = torch.diag(torch.from_numpy(homogeneous_std(0.1)) ** 2)
    for r in (0, 1):
        assert_close(exploration.covariance[r], expected, rtol=1e-12, atol=0)
    assert_close(exploration.covariance[2], alone, rtol=1e-9, atol=1e-13)
    assert draw(exploration, 4).isfinite().all()


def test_a_motion_that_nothing_moves_gets_no_noise_with_damping():
    """The time step is so short that the squares of the Jacobian are zero."""
    exploration = TrajectorySpace(make_policy(), START, T, 1e-200, 0.5)
    assert not exploration.covariance.any()
    assert exploration.covariance.isfinite().all()


@pytest.mark.parametrize("x0", [START, STARTS], ids=["one start", "three"])
@pytest.mark.parametrize("Q", [1, 2])
@pytest.mark.parametrize("damping", [0.0, 1e-2])
def test_stiffness_along_the_motion_counts_beside_the_positions_each_by_its_spread(x0, Q, damping):
    policy = make_policy(Q=Q)
    options = {"stiffness_spread": 3.0, "mean_stiffness": 2.0, "widening": 2.0, "damping": damping}
    exploration = make(policy, x0, spread=0.4, **options)

    def outputs(theta):
        path = Path(policy, x0, T)
        values = {f"policy.{name}": v for name, v in policy.split(theta).items()}
        x = functional_call(path, values, ())
        before = torch.cat([x0.unsqueeze(-2), x[..., :-1, :]], -2)
        rows = functional_call(Rows(policy), values, (before,))
        return torch.cat([x.flatten() / 0.4, rows.flatten() / 3.0])

    J = torch.func.jacrev(outputs)(policy.pack().detach()).numpy()
    n = T * x0.numel() / 2
    speed = homogeneous_std(0.1).reshape(2, 6)
    size = np.sqrt(MEANS**2 + np.diagonal(COVARIANCES, axis1=1, axis2=2))
    share = 2.0 * math.sqrt(math.pi / 2 / 3)  # the mean of |z| is √(2/π)
    std = np.concatenate(
        [
            np.concatenate([speed[k, :4], *[share / size[k]] * Q, speed[k, 4:], [share] * Q])  # Eq. 44-45
            for k in range(2)
        ]
    )
    if damping:
        values, V = np.linalg.eigh(np.diag(std) @ (J.T @ J / n) @ np.diag(std))
        variances = 1 / (values + 1 / 4) * values / (values + damping * values.max())
        expected = np.diag(std) @ V @ np.diag(variances) @ V.T @ np.diag(std)
    else:
        expected = np.linalg.inv(J.T @ J / n + np.diag(1 / (2 * std) ** 2))
    np.testing.assert_allclose(exploration.covariance, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    parts = policy.split(draw(exploration, 6))
    assert all(value.all() for value in parts.values())


def test_each_output_has_its_own_spread(random_policy, randn):
    policy, x0, spread = random_policy(O=3), randn(2), torch.tensor([0.4, 0.2, 0.03], dtype=torch.float64)
    along = TrajectorySpace(policy, x0, T, DT, spread, widening=3.0, damping=0.0)
    J = sensitivity(policy, rollout(policy, x0, T, DT)) / spread[:, None]  # (T, O, P)
    D = 9.0 * policy.join(Homogeneous(policy, 0.1).std()).square()
    metric = torch.einsum("top,toq->pq", J, J) / T
    assert_close(along.covariance, torch.linalg.inv(metric + torch.diag(1 / D)), rtol=1e-8, atol=1e-12)


def test_float32_gives_the_same_in_float32():
    double = make(x0=STARTS, damping=1e-2)
    single = make(make_policy(torch.float32), STARTS.float(), damping=1e-2)
    assert single.factor.dtype == draw(single, 2).dtype == torch.float32
    scale = double.covariance.abs().max()
    assert_close(single.covariance.double() / scale, double.covariance / scale, rtol=0, atol=1e-4)


# ------------------------------------------------------------------ coordinates for other searchers


@pytest.mark.parametrize("batch", [(), (3,)])
def test_coordinates_are_a_centre_and_a_factor(batch):
    policy = make_batch(3) if batch else make_policy()
    exploration = make(policy)
    coordinates = exploration.coordinates()
    theta = policy.pack().detach().clone()
    assert torch.equal(coordinates.center, theta)
    assert_close(coordinates.factor @ coordinates.factor.mT, exploration.covariance, rtol=0, atol=0)
    z = torch.randn(*batch, 12, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    expected = theta.numpy() + np.einsum("...ij,...j->...i", coordinates.factor.numpy(), z.numpy())
    np.testing.assert_allclose(coordinates.theta(z), expected, rtol=1e-13, atol=1e-15)
    assert torch.equal(coordinates.theta(0 * z), theta)
    with torch.no_grad():
        policy.A.add_(1.0)  # learning goes on
    assert torch.equal(coordinates.center, theta)
    assert not torch.equal(exploration.refresh_now(), coordinates.factor)


# ------------------------------------------------------------------ refresh, checkpoints


def make_learner(refresh=1, n_rollouts=5):
    policy = make_policy()
    exploration = make(policy, refresh=refresh)
    optim = PIBB(policy.parameters(), exploration, n_rollouts, control_weight=0.01)
    return policy, optim, torch.optim.lr_scheduler.LambdaLR(optim, ExponentialDecay(6, 0.2))


def learn(policy, optim, decay, updates):
    for _ in range(updates):
        optim.step(lambda: torchds.costs.goal(rollout(policy, START, T, DT).x, GOAL))
        decay.step()


@pytest.mark.parametrize(("refresh", "evaluations"), [(1, 7), (2, 4), (3, 3), (7, 1), (100, 1)])
def test_the_jacobian_is_evaluated_every_few_updates(monkeypatch, refresh, evaluations):
    seen, original = [], trajectory.sensitivity
    monkeypatch.setattr(
        trajectory, "sensitivity", lambda policy, path: seen.append(policy.pack().detach()) or original(policy, path)
    )
    policy, optim, decay = make_learner(refresh)
    before = []
    for _ in range(7):
        before.append(policy.pack().detach())
        learn(policy, optim, decay, 1)
    assert len(seen) == evaluations
    assert all(map(torch.equal, seen, before[::refresh]))  # at the parameters of that update, unperturbed


def test_looking_at_the_covariance_changes_nothing():
    learners = [make_learner(3), make_learner(3)]
    for _ in range(5):
        for learner in learners:
            learn(*learner, 1)
        covariance, _ = learners[0][1].explorations[0].covariance, learners[0][1].explorations[0].coordinates()
    assert torch.equal(learners[0][0].pack(), learners[1][0].pack())
    assert torch.equal(covariance, learners[1][1].explorations[0].covariance)


def test_refresh_now_evaluates_at_the_present_parameters():
    policy = make_policy()
    exploration = make(policy, refresh=10)
    first = exploration.factor
    with torch.no_grad():
        policy.A.add_(0.2)
    assert exploration.factor is first
    assert torch.equal(exploration.refresh_now(), make(policy).factor)
    assert not torch.equal(exploration.factor, first)


@pytest.mark.parametrize("refresh", [1, 3])
@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize("done", [0, 2, 3])
@pytest.mark.slow
def test_a_run_continues_from_a_checkpoint_bit_for_bit(tmp_path, refresh, asked, done):
    whole = make_learner(refresh)
    learn(*whole, done)
    if asked:
        whole[1].ask()
    names = ("policy", "optim", "decay")
    torch.save({name: part.state_dict() for name, part in zip(names, whole, strict=True)}, tmp_path / "run.pt")
    saved = torch.load(tmp_path / "run.pt", weights_only=True)
    resumed = make_learner(refresh)
    learn(*resumed, 1)  # whatever stood there is overwritten
    for name, part in zip(names, resumed, strict=True):
        part.load_state_dict(saved[name])
    for learner in (whole, resumed):
        learn(*learner, 4)
    assert torch.equal(whole[0].pack(), resumed[0].pack())
    assert torch.equal(whole[1].explorations[0].factor, resumed[1].explorations[0].factor)
    assert all(map(torch.equal, whole[1].last, resumed[1].last))


def test_a_checkpoint_without_the_covariance_would_go_another_way():
    """Guards the test above: with refresh=3 the covariance is not that of the present parameters."""
    whole, resumed = make_learner(3), make_learner(3)
    learn(*whole, 2)
    for mine, theirs in zip(resumed, whole, strict=True):
        state = theirs.state_dict()
        if "explorations" in state:
            state["explorations"] = [{"age": 0, "factor": None, "felt": None}]
        mine.load_state_dict(state)
    for learner in (whole, resumed):
        learn(*learner, 1)
    assert not torch.allclose(whole[0].pack(), resumed[0].pack())


def test_a_deep_copy_continues_equally_on_a_policy_of_its_own():
    policy, optim, decay = make_learner(3)
    learn(policy, optim, decay, 2)
    twin, twin_optim, twin_decay = copy.deepcopy((policy, optim, decay))
    assert twin_optim.explorations[0].policy is twin
    before = twin.pack()
    learn(policy, optim, decay, 3)
    assert torch.equal(twin.pack(), before)
    learn(twin, twin_optim, twin_decay, 3)
    assert torch.equal(twin.pack(), policy.pack())
    assert not torch.equal(twin.pack(), before)


def test_the_scale_of_the_normals_scales_the_noise():
    one, half = make(), make()
    parameters = list(one.policy.parameters())
    z = [torch.ones(2, *p.shape, dtype=torch.float64) for p in parameters]
    for a, b in zip(one(parameters, z), half(list(half.policy.parameters()), [0.5 * y for y in z]), strict=True):
        assert_close(a, 2 * b, rtol=1e-14, atol=0)


# ------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spread": 0.0}, "spread has to be finite and positive, one number or (2,), got 0.0"),
        ({"spread": float("inf")}, "spread has to be finite and positive, one number or (2,), got inf"),
        ({"widening": -1.0}, "widening has to be finite and positive, got -1.0"),
        ({"mean_speed": float("nan")}, "mean_speed has to be finite and positive, got nan"),
        ({"damping": -1e-3}, "damping has to be ≥ 0 and refresh at least 1, got -0.001 and 1"),
        ({"damping": float("nan")}, "damping has to be ≥ 0 and refresh at least 1, got nan and 1"),
        ({"refresh": 0}, "damping has to be ≥ 0 and refresh at least 1, got 0.01 and 0"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(InvalidArgumentError, match=re.escape(message)):
        make(**options)


@pytest.mark.parametrize(
    ("options", "received"),
    [
        ({}, "None and 0.0"),
        ({"stiffness_spread": 2.0}, "2.0 and 0.0"),
        ({"mean_stiffness": 3.0}, "None and 3.0"),
        ({"stiffness_spread": -2.0, "mean_stiffness": 3.0}, "-2.0 and 3.0"),
        ({"stiffness_spread": float("nan"), "mean_stiffness": 3.0}, "nan and 3.0"),
    ],
)
def test_a_policy_with_stiffness_needs_both_sizes_of_it(options, received):
    message = f"have to be positive for a policy with stiffness rows, got {received}"
    with pytest.raises(InvalidArgumentError, match=message):
        make(make_policy(Q=1), **options)


def test_a_part_of_the_parameters_is_refused():
    policy = make_policy(Q=1)
    message = r"TrajectorySpace explores all parameters of a policy together, but \['b', 'stiffness_b'\] are not in"
    with pytest.raises(InvalidArgumentError, match=message):
        PIBB([policy.A, policy.stiffness_A], make(policy, stiffness_spread=1.0, mean_stiffness=1.0))
    with pytest.raises(InvalidArgumentError, match=r"but \['A', 'stiffness_A', 'stiffness_b'\] are not in the group"):
        along = make(policy, stiffness_spread=1.0, mean_stiffness=1.0)
        PIBB([{"params": [policy.A]}, {"params": [policy.b], "exploration": along}], Homogeneous(policy))


def test_parameters_of_another_policy_are_refused():
    with pytest.raises(InvalidArgumentError, match=r"TrajectorySpace explores \['A', 'b'\] of the policy it was made"):
        PIBB(make_policy().parameters(), make())
