"""The letters of the authors' program: costs in numpy, the plant and all, settings and fit."""

import numpy as np
import pytest
import torch

import tasks
from tasks.released.exploration import ReleasedHomogeneous
from torchds import Demonstrations, GaussianMixture
from torchds.errors import InvalidArgumentError

RELEASED = {
    "N": ((-130.0, -100.0), [(-120.0, -10.0), (-60.0, -40.0), (-30.0, -110.0)], 120),
    "P": ((-40.0, -20.0), [(-45.0, 20.0), (-10.0, 30.0), (10.0, 15.0)], 150),
}


def synthetic_mixture():
    """Two Gaussians in millimetres, with different experts that lead towards the origin."""
    means = np.array([[-90.0, -60.0], [-10.0, 5.0]])
    slopes = np.array([[[-0.3, 0.25], [-0.35, -0.2]], [[-0.4, -0.3], [0.2, -0.35]]])
    inputs = np.array([[[1600.0, 200.0], [200.0, 900.0]], [[700.0, -200.0], [-200.0, 500.0]]])
    velocities = np.einsum("kij,kj->ki", slopes, means) + np.array([[3.0, 2.0], [-2.0, 1.0]])
    centres = np.concatenate([means, velocities], -1)
    cross = slopes @ inputs
    covariances = np.block([[inputs, cross.swapaxes(1, 2)], [cross, cross @ slopes.swapaxes(1, 2) + np.eye(2)]])
    return GaussianMixture(*(torch.tensor(value) for value in (np.array([0.4, 0.6]), centres, covariances)))


def released_costs(policy, r, shape):
    """Steps and terms of one policy, the plant and all in numpy: N on the plant, P on the reference."""
    start, points, n_steps = RELEASED[shape]
    A, b = policy.A[r].detach().numpy(), policy.b[r].detach().numpy()
    reference = q = np.array(start)
    qd, path, squares = np.zeros(2), [], []
    for _ in range(n_steps):
        h = policy.gating(torch.from_numpy(reference)).numpy()
        v = sum(h[k] * (A[k] @ reference + b[k]) for k in range(len(h)))
        reference = reference + v * 0.1
        u = 10 * (reference - q) + 2 * np.sqrt(10) * (v - qd)
        qdd = u - qd
        qd = qd + qdd * 0.1
        q = q + qd * 0.1
        path.append(q if shape == "N" else reference)
        squares.append(1e-4 * (qdd**2).sum())
    via = sum(min(((np.array(p) - x) ** 2).sum() for x in path) for p in points)
    return squares, {"via_points": via, "goal": (path[-1] ** 2).sum(), "acceleration": sum(squares)}


@pytest.mark.parametrize("shape", ["N", "P"])
@pytest.mark.slow
def test_cost_terms_are_those_of_the_released_program(shape):
    task = tasks.make("via_point", shape=shape, convention="released", mixture=synthetic_mixture())
    policy = task.policy().expand(3)
    generator = torch.Generator().manual_seed(9)
    with torch.no_grad():
        policy.A.add_(0.02 * torch.randn(policy.A.shape, generator=generator, dtype=torch.float64))
        policy.b.add_(1.0 * torch.randn(policy.b.shape, generator=generator, dtype=torch.float64))
        path, terms = task.evaluate(policy)
        by_steps = task.step_costs(path)
    n_steps = RELEASED[shape][2]
    assert path.x.shape == (3, n_steps + 1, 2)
    for r in range(3):
        squares, expected = released_costs(policy, r, shape)
        for name, value in expected.items():
            assert terms[name][r].item() == pytest.approx(value, rel=1e-9), name
        squares[-1] += expected["via_points"] + expected["goal"]
        np.testing.assert_allclose(by_steps[r], squares, rtol=1e-9)
        deviation = (policy.pack()[r] - task.policy().pack()).detach().numpy()
        assert terms["control"][r].item() == pytest.approx(n_steps * 0.5 * 5e-4 * (deviation**2).sum(), rel=1e-9)
    assert (path.x - path.reference).norm(dim=-1).amax() > 0.3  # plant and reference are not the same


def test_the_released_settings_are_those_of_its_program():
    search = tasks.make("via_point", convention="released", mixture=synthetic_mixture()).search
    assert (search.n_updates, search.n_rollouts, search.elite, search.control_weight) == (50, 10, "none", 5e-4)
    assert (search.homogeneous, search.temperature, search.decay) == (ReleasedHomogeneous, "median", "linear")
    assert search.mean_speed == 0.1


@pytest.mark.slow
def test_the_released_policy_is_fitted_with_a_floor_that_is_added_twice():
    rng, s = np.random.default_rng(0), np.linspace(0, 1, 80)[:, None]
    curve = np.hstack([-130 * (1 - s) ** 2, -100 * (1 - s) + 80 * np.sin(5 * s) * (1 - s)])
    demonstrations = Demonstrations([curve + rng.normal(size=(80, 2)) for _ in range(3)], dt=0.1).forward_differences()
    task = tasks.make("via_point", convention="released", demonstrations=demonstrations)
    once = GaussianMixture.fit(demonstrations, 4, covariance_floor=1e-5, tol=1e-10)
    difference = task.mixture.covariances - once.covariances
    torch.testing.assert_close(difference, 1e-5 * torch.eye(4).double().expand(4, 4, 4), rtol=0, atol=1e-11)
    assert task.policy().n_components == 4


@pytest.mark.parametrize("shape", ["N", "P"])
def test_the_released_problem_without_data_says_what_to_give(shape):
    task = tasks.make("via_point", shape=shape, convention="released")
    message = r"via_point with convention='released' has no demonstrations.*give demonstrations=PATH or mixture=PATH"
    for use in (task.policy, lambda: task.mixture, lambda: task.demonstrations):
        with pytest.raises(InvalidArgumentError, match=message):
            use()
    assert tasks.make("via_point", convention="released", mixture=synthetic_mixture()).source is None
