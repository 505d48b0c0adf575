"""The box of the authors' program: collisions and costs in numpy, and the hole in it."""

import numpy as np
import pytest
import torch

import tasks
from torchds import GaussianMixture
from torchds.errors import InvalidArgumentError


def linear_mixture(A):
    """One Gaussian over [x, v] whose regression is v = A x."""
    A = torch.as_tensor(A, dtype=torch.float64)
    covariance = 4.0 * torch.eye(2, dtype=torch.float64)
    joint = torch.cat(
        [torch.cat([covariance, covariance @ A.T], 1), torch.cat([A @ covariance, A @ covariance @ A.T], 1)]
    )
    mean = torch.tensor([-3.0, -1.0], dtype=torch.float64)
    joint = joint + 1e-3 * torch.diag(torch.tensor([0.0, 0.0, 1.0, 1.0], dtype=torch.float64))
    return GaussianMixture(torch.ones(1, dtype=torch.float64), torch.cat([mean, A @ mean])[None], joint[None])


def released_box(A):
    """The cost terms and the plant's track, in numpy; inside a block plant and reference rest, the controller pulls on."""

    def inside(q):
        return (-2.5 < q[0] < -1.5 and 0 < q[1] < 2) or (-2.5 < q[0] < 2.5 and -2.5 < q[1] < -1.5)

    A, q = np.asarray(A), np.array([-6.0, -2.0])
    reference, qd, free = q, np.zeros(2), q
    accelerations, length, track = 0.0, 0.0, [q]
    for _ in range(150):
        v, free = A @ free, free + A @ free * 0.1
        stuck = inside(q)
        v = np.zeros(2) if stuck else v
        reference = reference + v * 0.1
        qdd = 10 * (reference - q) + 2 * np.sqrt(10) * (v - qd) - qd
        if not stuck:
            qd = qd + qdd * 0.1
            q = q + qd * 0.1
            if inside(q):
                qd = np.zeros(2)
        accelerations += np.linalg.norm(qdd)
        length += np.linalg.norm(qd) * 0.1
        track.append(q)
    terms = {"goal": 10 * q @ q, "acceleration": 1e-3 * accelerations, "path_length": length - 8.815}
    return terms, np.array(track)


@pytest.mark.parametrize(
    ("A", "hits"),
    [
        ([[-0.4, 0.0], [0.0, -0.4]], False),  # straight through the hole
        ([[-0.4, 0.0], [0.0, -0.02]], True),  # into the floor
        ([[-0.3, 0.0], [-0.2, -0.2]], True),  # into the left wall
    ],
)
@pytest.mark.slow
def test_cost_terms_and_collisions_are_those_of_the_released_program(A, hits):
    task = tasks.make("constrained_reaching", convention="released", mixture=linear_mixture(A))
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    expected, track = released_box(A)
    np.testing.assert_allclose(path.x.numpy(), track, rtol=0, atol=1e-9)
    assert bool(task.plant.inside(path.x[-1])) == hits
    for name, value in expected.items():
        assert float(terms[name]) == pytest.approx(value, rel=1e-9, abs=1e-9), name


@pytest.mark.slow
def test_the_released_box_has_a_hole_through_which_the_cost_falls_below_zero():
    task = tasks.make("constrained_reaching", convention="released", mixture=linear_mixture([[-0.4, 0.0], [0.0, -0.4]]))
    with torch.no_grad():
        _, terms = task.evaluate(task.policy())
    assert sum(terms.values()) < -2.0


def test_the_released_problem_needs_data():
    with pytest.raises(InvalidArgumentError, match="give demonstrations=PATH or mixture=PATH"):
        tasks.make("constrained_reaching", convention="released").policy()


def test_the_released_problem_has_no_stability_condition():
    with pytest.raises(InvalidArgumentError, match="has no stability condition, got 'p-qlf'; leave it out"):
        tasks.make("constrained_reaching", convention="released", condition="p-qlf")
