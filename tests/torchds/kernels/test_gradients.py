"""The adjoint, the Jacobians and the control cost in compiled code, against autograd and the eager formulas."""

import copy

import pytest
import torch

from torchds import Bounds, GMRPolicy, costs, kernels, rollout
from torchds.sensitivity import sensitivity, stiffness_sensitivity

pytestmark = pytest.mark.skipif(not kernels.available()["cpu"], reason="needs numba")


def gradients(policy, x0, weights, backend, **options):
    """Of a sum of everything that a roll-out holds, each number with a weight of its own."""
    start = x0.clone().requires_grad_()
    path = rollout(policy, start, backend=backend, **options)
    fields = [path.x, path.v, path.features, path.inputs] + ([] if path.stiffness is None else [path.stiffness])
    total = sum((weights(*field.shape) * field).sum() for field in fields)
    return torch.autograd.grad(total, [start, *policy.parameters()])


@pytest.mark.parametrize(("K", "D", "O", "Q"), [(1, 1, 1, 0), (4, 2, 2, 0), (3, 2, 3, 1), (3, 3, 3, 3)])
@pytest.mark.parametrize(("batch", "points"), [((), ()), ((4,), ()), ((), (3,)), ((3, 2), (2, 2))])
@pytest.mark.slow
def test_the_adjoint_is_what_autograd_gives(random_policy, randn, K, D, O, Q, batch, points):
    policy = random_policy(K, D, O, Q, batch=batch)
    for shift, stop, per_policy in ((None, None, False), (randn(D), Bounds(-1.0, 1.5), True)):
        x0 = 0.5 * randn(*(batch if per_policy else ()), *points, D)
        options = {"n_steps": 40, "dt": 0.02, "shift": shift, "stop": stop}
        options["starts"] = "per_policy" if per_policy else "shared"
        found = []
        for backend in ("fused", "eager"):
            generator = torch.Generator().manual_seed(1)
            weights = lambda *shape, g=generator: torch.randn(*shape, generator=g, dtype=torch.float64)  # noqa: E731
            found.append(gradients(policy, x0, weights, backend, **options))
        for fused, eager in zip(*found, strict=True):
            torch.testing.assert_close(fused, eager, rtol=1e-10, atol=1e-11 * float(eager.abs().amax()))


@pytest.mark.slow
def test_gradcheck_first_and_second(random_policy, randn):
    policy = random_policy(3, 2, 2, 1)

    def motion(x0):
        path = rollout(policy, x0, 6, 0.1, backend="fused")
        return path.x, path.features, path.stiffness

    x0 = (0.3 * randn(2, 2)).requires_grad_()
    assert torch.autograd.gradcheck(motion, (x0,))
    assert torch.autograd.gradgradcheck(motion, (x0,))


def test_a_gating_of_its_own_for_each_policy(random_mixture, randn):
    policy = GMRPolicy.from_mixture(random_mixture(3, 4, batch=(5,)), 2)
    ones = lambda *shape: torch.ones(*shape, dtype=torch.float64)  # noqa: E731
    options = {"n_steps": 20, "dt": 0.05}
    x0 = randn(4, 2)
    for a, b in zip(*(gradients(policy, x0, ones, s, **options) for s in ("fused", "eager")), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_adam_learns_the_same_through_both(random_policy, randn, monkeypatch):
    ends, initial = [], random_policy(3)
    for backend in ("fused", "eager"):
        monkeypatch.setenv("TORCHDS_BACKEND", backend)
        policy = copy.deepcopy(initial)
        policy.unpack(torch.linspace(-1.0, 0.5, policy.pack().shape[-1], dtype=torch.float64))
        optim = torch.optim.Adam(policy.parameters(), lr=0.03)
        for _ in range(20):
            optim.zero_grad()
            rollout(policy, torch.ones(2, dtype=torch.float64), 30, 0.05).x[-1].square().sum().backward()
            optim.step()
        ends.append(policy.pack().detach())
    assert (ends[0] - ends[1]).abs().amax() < 1e-8 and ends[0].abs().amax() > 0


@pytest.mark.parametrize(("K", "D", "O", "Q"), [(1, 1, 1, 0), (4, 2, 2, 0), (3, 2, 3, 1), (3, 3, 3, 3)])
@pytest.mark.parametrize(("batch", "points"), [((), ()), ((4,), ()), ((3, 2), (2, 2))])
@pytest.mark.parametrize("stop", [None, Bounds(-0.7, 0.7)])
def test_sensitivities(random_policy, randn, monkeypatch, K, D, O, Q, batch, points, stop):
    policy = random_policy(K, D, O, Q, batch=batch)
    path = rollout(policy, 0.5 * randn(*points, D), 30, 0.05, stop=stop, shift=randn(D), backend="eager")
    found = {}
    for backend in ("eager", "fused"):
        monkeypatch.setenv("TORCHDS_BACKEND", "eager" if backend == "eager" else "auto")
        J = sensitivity(policy, path)
        found[backend] = [J] + ([stiffness_sensitivity(policy, path, J)] if Q else [])
    for eager, fused in zip(found["eager"], found["fused"], strict=True):
        torch.testing.assert_close(fused, eager, rtol=1e-11, atol=1e-12 * float(eager.abs().amax()))
        assert stop is not None or not torch.equal(fused, eager)  # it was another computation


def test_sensitivities_under_a_gating_of_its_own(random_mixture, randn, monkeypatch):
    policy = GMRPolicy.from_mixture(random_mixture(3, 5, batch=(5,)), 2, stiffness_dim=1)
    path = rollout(policy, randn(3, 2), 20, 0.05, backend="eager")
    monkeypatch.setenv("TORCHDS_BACKEND", "auto")
    J = sensitivity(policy, path), stiffness_sensitivity(policy, path, sensitivity(policy, path))
    monkeypatch.setenv("TORCHDS_BACKEND", "eager")
    torch.testing.assert_close(J[0], sensitivity(policy, path))
    torch.testing.assert_close(J[1], stiffness_sensitivity(policy, path, J[0]))


@pytest.mark.parametrize("points", [(), (2,), (2, 3)])
@pytest.mark.parametrize("weight", [0.3, "diagonal", "some free"])
def test_control_costs(randn, monkeypatch, points, weight):
    deviation, noise, features = randn(6, 3, 4, 12), randn(6, 3, 4, 12), randn(6, 3, *points, 50, 12)
    if weight != 0.3:
        weight = randn(6, 3, 4, 12).abs() * (1.0 if weight == "diagonal" else (randn(4, 12) > 0))
    features[0, 0, ..., 7, :] = 0.0  # nothing visited: the noise costs nothing
    features[1, 1, ..., 8, 3] = torch.inf
    monkeypatch.setenv("TORCHDS_BACKEND", "auto")
    fused = costs.control_cost(deviation, noise, features, weight)
    monkeypatch.setenv("TORCHDS_BACKEND", "eager")
    eager = costs.control_cost(deviation, noise, features, weight)
    assert fused.shape == eager.shape == (6, 3, *points, 50)
    torch.testing.assert_close(fused, eager, rtol=1e-11, atol=1e-11, equal_nan=True)
    assert not torch.equal(fused, eager)
