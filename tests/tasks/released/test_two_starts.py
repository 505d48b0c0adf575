"""The two starts of the authors' program: costs in numpy, the plant and all, settings and fit."""

import numpy as np
import pytest
import torch

import tasks
from tasks.released.exploration import ReleasedHomogeneous
from torchds import Demonstrations, GaussianMixture
from torchds.errors import EqualCostsWarning, InvalidArgumentError
from torchds.exploration import Homogeneous
from torchds.optim import PIBB

RELEASED_LEFT = [(-6.0, -3.0), (-4.0, 0.0), (-2.0, 3.0)]
RELEASED_RIGHT = [(6.0, 0.0), (5.0, -4.0), (3.0, -4.0), (2.0, 0.0)]


def vary(policy, n, size):
    """A batch of n policies near `policy`."""
    theta = policy.pack().detach()
    generator = torch.Generator().manual_seed(9)
    return policy.unpack(theta + size * torch.randn(n, len(theta), generator=generator, dtype=torch.float64))


def via(x, points):
    """Σ_l min_{j ≥ 1} |x_l − x_j|² in loops."""
    return sum(min(((np.array(p) - x_j) ** 2).sum() for x_j in x[1:]) for p in points)


def synthetic_mixture():
    """Two Gaussians on either side of the origin, with different experts that lead there slowly."""
    means = np.array([[-4.0, 1.0], [5.0, -2.0]])
    slopes = np.array([[[-0.3, 0.2], [-0.25, -0.2]], [[-0.4, -0.3], [0.2, -0.35]]])
    inputs = np.array([[[9.0, 1.0], [1.0, 4.0]], [[7.0, -2.0], [-2.0, 5.0]]])
    velocities = np.einsum("kij,kj->ki", slopes, means) + np.array([[0.1, 0.2], [-0.2, 0.1]])
    centres = np.concatenate([means, velocities], -1)
    cross = slopes @ inputs
    covariances = np.block([[inputs, cross.swapaxes(1, 2)], [cross, cross @ slopes.swapaxes(1, 2) + 0.01 * np.eye(2)]])
    return GaussianMixture(*(torch.tensor(value) for value in (np.array([0.4, 0.6]), centres, covariances)))


def released_costs(policy, r):
    """The three terms of one policy, the plant and all in numpy, one start after the other."""
    h_of = policy.gating
    A, b = policy.A[r].detach().numpy(), policy.b[r].detach().numpy()
    accelerations, vias, goals = [], [], []
    for start in ((-8.0, 0.0), (8.0, 0.0)):
        reference = np.array(start)
        q, qd, Q, squares = reference, np.zeros(2), [reference], 0.0
        for _ in range(110):
            h = h_of(torch.from_numpy(reference)).numpy()
            v = sum(h[k] * (A[k] @ reference + b[k]) for k in range(len(h)))
            reference = reference + v * 0.1
            u = 10 * (reference - q) + 2 * np.sqrt(10) * (v - qd)
            qdd = u - qd
            qd = qd + qdd * 0.1
            q = q + qd * 0.1
            Q.append(q)
            squares += (qdd**2).sum()
        vias.append(min(via(Q, RELEASED_LEFT), via(Q, RELEASED_RIGHT)))
        goals.append((q**2).sum())
        accelerations.append(squares)
    # Means over the starts; by the slip of an index, only the last start's acceleration enters that mean.
    return {"via_points": np.mean(vias), "goal": np.mean(goals), "acceleration": 2e-4 * accelerations[1] / 2}


@pytest.mark.slow
def test_cost_terms_are_those_of_the_released_program():
    task = tasks.make("two_starts", convention="released", mixture=synthetic_mixture())
    policy = vary(task.policy(), 3, 0.03)
    with torch.no_grad():
        path, terms = task.evaluate(policy)
    assert path.x.shape == (3, 2, 111, 2)
    assert not torch.equal(path.x, path.reference)
    for r in range(3):
        for name, expected in released_costs(policy, r).items():
            assert terms[name][r].item() == pytest.approx(expected, rel=1e-9), name
        deviation = (policy.pack()[r] - task.policy().pack()).detach().numpy()
        assert terms["control"][r].item() == pytest.approx(110 * 0.5 * 5e-4 * (deviation**2).sum(), rel=1e-9)


def test_the_released_search_adds_the_same_control_cost_as_the_evaluation():
    """The mean over the starts, by half the weight of the sum."""
    task = tasks.make("two_starts", convention="released", mixture=synthetic_mixture())
    policy = vary(task.policy(), 2, 0.03)
    expected = task.evaluate(policy)[1]["control"]
    optim = PIBB(policy.parameters(), Homogeneous(policy, 0.0), n_rollouts=2, control_weight=task.search.control_weight)
    with pytest.warns(EqualCostsWarning):  # without noise there is nothing to learn
        optim.step(lambda: task.cost(task.rollout(policy)))
    torch.testing.assert_close(optim.last.control[0], expected.detach(), rtol=1e-10, atol=0)


@pytest.mark.slow
def test_the_released_policy_is_of_seven_gaussians_fitted_with_a_floor_that_is_added_twice():
    rng = np.random.default_rng(0)
    demos = []
    for side in (-8.0, 8.0):
        for _ in range(3):
            s = np.linspace(0, 1, 80)[:, None]
            bow = rng.normal(2.0, 0.3) * np.sin(np.pi * s)
            demos.append(np.hstack([side * (1 - s) ** 2, bow]) + 0.01 * rng.normal(size=(80, 2)))
    demonstrations = Demonstrations(demos, dt=0.1)
    task = tasks.make("two_starts", convention="released", demonstrations=demonstrations)
    assert task.policy().n_components == 7
    once = GaussianMixture.fit(demonstrations.forward_differences(), 7, covariance_floor=1e-5, tol=1e-10)
    difference = task.mixture.covariances - once.covariances
    torch.testing.assert_close(difference, 1e-5 * torch.eye(4).double().expand(7, 4, 4), rtol=0, atol=1e-15)
    assert torch.equal(task.mixture.means, once.means)
    assert all(torch.equal(mine.x, given.x) for mine, given in zip(task.source, demonstrations, strict=True))


def test_the_released_settings_are_those_of_its_program():
    search = tasks.make("two_starts", convention="released", mixture=synthetic_mixture()).search
    assert (search.n_updates, search.n_rollouts, search.elite) == (200, 20, "best")
    assert (search.homogeneous, search.temperature, search.decay) == (ReleasedHomogeneous, "median", "linear")
    assert (search.mean_speed, search.control_weight) == (0.1, 2.5e-4)


def test_the_released_problem_without_data_says_what_to_give():
    task = tasks.make("two_starts", convention="released")
    message = r"two_starts with convention='released' has no demonstrations.*give demonstrations=PATH or mixture=PATH"
    with pytest.raises(InvalidArgumentError, match=message):
        task.policy()
