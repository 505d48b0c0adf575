"""The Jacobian of a roll-out against finite differences, autograd through the roll-out, and closed forms."""

import copy

import numpy as np
import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.testing import assert_close

from torchds import Bounds, GMRPolicy, rollout
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass
from torchds.sensitivity import sensitivity, stiffness_sensitivity


class Path(nn.Module):
    """The states 1..T of a roll-out, and the integrals of velocities beyond the inputs, for `functional_call`."""

    def __init__(self, policy, x0, n_steps, dt, stop=None):
        super().__init__()
        self.policy = policy
        self.options = {"x0": x0, "n_steps": n_steps, "dt": dt, "stop": stop}

    def forward(self):
        path = rollout(self.policy, **self.options)
        D = path.x.shape[-1]
        return torch.cat([path.x[..., 1:, :], path.dt * path.v[..., D:].cumsum(-2)], -1)


def by_autograd(policy, *options, of=Path):
    """(*points, T, D, P) of a single policy, backwards through the roll-out."""
    path = of(policy, *options)

    def motion(theta):
        return functional_call(path, {f"policy.{name}": value for name, value in policy.split(theta).items()}, ())

    return torch.func.jacrev(motion)(policy.pack().detach())


def single(policy, index):
    return copy.deepcopy(policy).unpack(policy.pack()[index])


@pytest.mark.parametrize("K", [1, 2, 3, 4])
@pytest.mark.parametrize(("D", "O", "Q"), [(1, 1, 0), (2, 2, 0), (2, 3, 0), (3, 3, 1), (2, 2, 2)])
def test_it_is_the_derivative_that_autograd_finds(random_policy, randn, K, D, O, Q):
    policy, x0 = random_policy(K, D, O, Q, moved=True), randn(2, D)
    J = sensitivity(policy, rollout(policy, x0, n_steps=12, dt=0.08))
    assert J.shape == (2, 12, O, K * (O + Q) * (D + 1))
    assert not J.requires_grad
    assert_close(J, by_autograd(policy, x0, 12, 0.08), rtol=1e-9, atol=1e-9)
    assert J.abs().max() > 0.1


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("points", [(), (3,), (2, 2)])
@pytest.mark.parametrize("starts", ["shared", "per_policy"])
def test_every_policy_of_a_batch_has_its_own_from_every_start(random_policy, randn, batch, points, starts):
    policy = random_policy(batch=batch, moved=True)
    x0 = randn(*(batch if starts == "per_policy" else ()), *points, 2)
    J = sensitivity(policy, rollout(policy, x0, n_steps=6, dt=0.1, starts=starts))
    assert J.shape == (*batch, *points, 6, 2, 18)
    for i in np.ndindex(batch):
        alone = by_autograd(single(policy, i), x0[i] if starts == "per_policy" else x0, 6, 0.1)
        assert_close(J[i], alone, rtol=1e-9, atol=1e-9)


def test_it_is_what_finite_differences_see(random_policy, randn):
    policy, x0, h = random_policy(O=3, Q=1, moved=True), randn(2), 1e-5
    J = sensitivity(policy, rollout(policy, x0, n_steps=30, dt=0.05))
    theta = policy.pack().detach()
    nudges = h * torch.eye(len(theta), dtype=torch.float64)
    paths = [rollout(copy.deepcopy(policy).unpack(theta + s * nudges), x0, 30, 0.05) for s in (1, -1)]
    both = [torch.cat([path.x[:, 1:], 0.05 * path.v[..., 2:].cumsum(-2)], -1) for path in paths]
    slopes = ((both[0] - both[1]) / (2 * h)).detach()  # (P, T, D)
    # The error of central differences is h² times a third derivative, about 1e-10, and rounding, 1e-16 / h.
    assert_close(J, slopes.movedim(0, -1), rtol=1e-7, atol=1e-8)


def test_a_linear_policy_has_the_derivative_of_a_geometric_sum():
    a, b, x0, dt, T = -0.7, 0.4, 1.5, 0.1, 40
    one = torch.ones(1, dtype=torch.float64)
    policy = GMRPolicy(one, 0 * one[None], one[None, None], a * one[None, None], b * one[None])
    J = sensitivity(policy, rollout(policy, torch.tensor([x0], dtype=torch.float64), T, dt))[:, 0].numpy()
    q = 1 + a * dt
    for t in range(1, T + 1):
        # x_t = qᵗ (x0 + b/a) − b/a
        along_a = t * dt * q ** (t - 1) * (x0 + b / a) - q**t * b / a**2 + b / a**2
        along_b = (q**t - 1) / a
        np.testing.assert_allclose(J[t - 1], [along_a, along_b], rtol=1e-12)


def test_the_first_state_moves_by_the_basis_times_dt(random_policy, randn):
    policy, x0 = random_policy(moved=True), randn(2)
    J = sensitivity(policy, rollout(policy, x0, n_steps=3, dt=0.2))
    assert_close(J[0], 0.2 * policy.basis(x0), rtol=1e-14, atol=0)


def test_stiffness_does_not_move_the_reference_nor_does_a_plant(random_policy, randn):
    policy, x0 = random_policy(Q=2, moved=True), randn(2)
    bare = GMRPolicy(policy.priors, policy.means, policy.covariances, policy.A, policy.b)
    J = sensitivity(policy, rollout(policy, x0, n_steps=10, dt=0.1))
    columns = policy.split(torch.arange(J.shape[-1]))
    assert not J[..., columns["stiffness_A"].flatten()].any()
    assert not J[..., columns["stiffness_b"].flatten()].any()
    expected = sensitivity(bare, rollout(bare, x0, n_steps=10, dt=0.1))
    for name, index in bare.split(torch.arange(expected.shape[-1])).items():
        assert_close(J[..., columns[name]], expected[..., index], rtol=1e-9, atol=1e-12)
    tracked = rollout(policy, x0, n_steps=10, dt=0.1, plant=ImpedanceControlled(PointMass(), 5.0))
    assert not torch.equal(tracked.x, tracked.reference)
    assert torch.equal(sensitivity(policy, tracked), J)


class Rows(nn.Module):
    """The stiffness asked for along a roll-out."""

    def __init__(self, policy, x0, n_steps, dt, stop=None):
        super().__init__()
        self.policy = policy
        self.options = {"x0": x0, "n_steps": n_steps, "dt": dt, "stop": stop}

    def forward(self):
        return rollout(self.policy, **self.options).stiffness


@pytest.mark.parametrize("Q", [1, 2])
@pytest.mark.parametrize("O", [2, 3])
@pytest.mark.parametrize("stop", [None, Bounds(-0.7, 0.7)])
def test_the_stiffness_moves_with_its_parameters_and_with_the_reference(random_policy, randn, Q, O, stop):
    policy, x0 = random_policy(O=O, Q=Q, batch=(2,), moved=True), 0.5 * randn(3, 2)
    path = rollout(policy, x0, n_steps=15, dt=0.1, stop=stop)
    if stop is not None:
        assert path.stopped.any()
        assert not path.resting[..., 0].all()
    J = stiffness_sensitivity(policy, path, sensitivity(policy, path))
    assert J.shape == (2, 3, 15, Q, 3 * (O + Q) * 3)
    for i in range(2):
        assert_close(J[i], by_autograd(single(policy, i), x0, 15, 0.1, stop, of=Rows), rtol=1e-9, atol=1e-9)


def test_where_a_roll_out_rests_nothing_moves_it_any_more(random_policy):
    policy = random_policy(moved=True, batch=(2,))
    with torch.no_grad():
        policy.A.copy_(torch.eye(2) * torch.tensor([2.0, -1.0])[:, None, None, None])
        policy.b.zero_()
    x0 = torch.tensor([[0.7, 0.3], [-0.4, 0.1]], dtype=torch.float64)
    stop = Bounds(-2.0, 2.0)
    path = rollout(policy, x0, n_steps=25, dt=0.1, stop=stop)
    J = sensitivity(policy, path)
    assert path.resting.any(-1).tolist() == [[True, True], [False, False]]
    for i in range(2):
        assert_close(J[i], by_autograd(single(policy, i), x0, 25, 0.1, stop), rtol=1e-9, atol=1e-9)
    for point in range(2):
        first = int(path.resting[0, point].int().argmax())
        assert 0 < first < 24
        assert torch.equal(J[0, point, first:], J[0, point, first - 1].expand(25 - first, -1, -1))


def test_a_start_that_is_not_a_number_rests_with_a_derivative_of_zero(random_policy):
    policy = random_policy()
    x0 = torch.tensor([[torch.nan, 0.0], [0.5, 0.0]], dtype=torch.float64)
    J = sensitivity(policy, rollout(policy, x0, n_steps=5, dt=0.1, stop=Bounds(-9.0, 9.0)))
    assert not J[0].any()
    assert J[1].isfinite().all()
    assert J[1].any()


@pytest.mark.slow
def test_a_motion_that_diverges_has_a_jacobian_that_is_not_finite_and_its_neighbours_do(random_policy):
    policy = random_policy(batch=(2,))
    with torch.no_grad():
        policy.A[0] = 1e6 * torch.eye(2)
    x0 = torch.ones(2, dtype=torch.float64)
    J = sensitivity(policy, rollout(policy, x0, n_steps=100, dt=0.1))
    assert not J[0].isfinite().all()
    assert_close(J[1], by_autograd(single(policy, 1), x0, 100, 0.1), rtol=1e-9, atol=1e-9)


def test_float32_stays_float32_and_close(random_policy, randn):
    policy, x0 = random_policy(moved=True), randn(3, 2)
    J = sensitivity(policy, rollout(policy, x0, n_steps=20, dt=0.05))
    policy.float()
    single_precision = sensitivity(policy, rollout(policy, x0.float(), n_steps=20, dt=0.05))
    assert single_precision.dtype == torch.float32
    assert_close(single_precision.double(), J, rtol=1e-4, atol=1e-4)
