"""Sizes as shares of the motion: the measures against numpy, and noise that scales as the motion does."""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous, Stable, TrajectorySpace
from torchds.exploration.shares import motion_size

STARTS = torch.tensor([[-1.2, 0.9], [-0.8, 0.2]], dtype=torch.float64)
GOAL = torch.tensor([0.3, -0.2], dtype=torch.float64)
T, DT = 25, 0.1


def make_policy(unit=1.0, pace=1.0, Q=0):
    """A stable motion to the goal in another unit of length, and at another pace."""
    A = pace * torch.tensor([[[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]], dtype=torch.float64)
    values = {
        "priors": [0.4, 0.6],
        "means": unit * np.array([[-0.9, 0.6], [0.5, -0.4]]),
        "covariances": unit**2 * np.array([[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]]),
        "A": A,
        "b": -(A @ (unit * GOAL)),
    }
    if Q:
        values |= {"stiffness_A": np.full((2, Q, 2), 3.0) / unit, "stiffness_b": np.full((2, Q), 20.0)}
    return GMRPolicy(**{name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()})


def noise_of(exploration, policy):
    generator = torch.Generator().manual_seed(2)
    parameters = list(policy.parameters())
    normals = [torch.randn(6, *p.shape, generator=generator, dtype=torch.float64) for p in parameters]
    names = [name for name, _ in policy.named_parameters()]
    return dict(zip(names, exploration(parameters, normals), strict=True))


MAKERS = {
    "homogeneous": lambda policy, x0, dt, goal: Homogeneous.relative(policy, x0, T, dt),
    "gaussian": lambda policy, x0, dt, goal: Gaussian.relative(policy, x0, T, dt),
    "stable": lambda policy, x0, dt, goal: Stable(
        policy, Gaussian.relative(policy, x0, T, dt, goal=goal), goal, margin=1e-9
    ),
    "trajectory": lambda policy, x0, dt, goal: TrajectorySpace.relative(policy, x0, T, dt),
    "stable-trajectory": lambda policy, x0, dt, goal: Stable(
        policy, TrajectorySpace.relative(policy, x0, T, dt, goal=goal), goal, margin=1e-9
    ),
}


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("pace", [1.0, 20.0])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_noise_scales_as_the_motion_does(name, unit, pace):
    """A is in 1/s, b in length per second, the stiffness stays."""
    Q = 0 if name == "stable-trajectory" else 1
    plain, policy = make_policy(Q=Q), make_policy(unit, pace, Q)
    expected = noise_of(MAKERS[name](plain, STARTS, DT, GOAL), plain)
    found = noise_of(MAKERS[name](policy, unit * STARTS, DT / pace, unit * GOAL), policy)
    assert expected["A"].abs().max() > 1e-3
    scales = {"A": pace, "b": unit * pace, "stiffness_A": 1 / unit, "stiffness_b": 1.0}
    for part, value in found.items():
        scale = expected[part].abs().max()
        assert_close(value / scales[part], expected[part], rtol=1e-6, atol=1e-6 * float(scale))


def test_the_sizes_are_those_of_the_roll_out():
    policy = make_policy(Q=2)
    size = motion_size(policy, STARTS, T, DT, GOAL)
    with torch.no_grad():
        path = rollout(policy, STARTS, T, DT)
    x, v = path.x.numpy(), path.v.numpy()
    moved = x[:, 1:]
    extent = math.sqrt((((moved - moved.mean(1, keepdims=True)) ** 2).sum(-1).sum(-1) / (T - 1)).mean())
    np.testing.assert_allclose(size.extent.numpy(), [extent] * 2, rtol=1e-12)
    assert size.speed == pytest.approx(np.linalg.norm(v, axis=-1).mean(), rel=1e-12)
    assert size.distance == pytest.approx(math.sqrt(((x[:, :-1] - GOAL.numpy()) ** 2).sum(-1).mean()), rel=1e-12)
    assert size.stiffness == pytest.approx(np.abs(path.stiffness.numpy()).mean(), rel=1e-12)
    assert motion_size(make_policy(), STARTS, T, DT).stiffness == 0.0


def test_homogeneous_shares_are_shares_of_mean_speed_and_mean_stiffness():
    policy = make_policy(Q=1)
    size, noise = motion_size(policy, STARTS, T, DT), Homogeneous.relative(policy, STARTS, T, DT, 0.3, stiffness=0.5)
    assert (noise.mean_speed, noise.mean_stiffness) == (0.3 * size.speed, 0.5 * size.stiffness)


@pytest.mark.parametrize("goal", [None, GOAL])
def test_gaussian_shares_give_a_velocity_noise_of_the_share(goal):
    """One expert, seen from a point at the distance that the motion has on average: E|ε_A (x − x*) + ε_b|."""
    policy = make_policy()
    size, noise = motion_size(policy, STARTS, T, DT, goal), Gaussian.relative(policy, STARTS, T, DT, 0.3, goal=goal)
    generator = torch.Generator().manual_seed(0)
    parameters = list(policy.parameters())
    A, b = noise(parameters, [torch.randn(40_000, *p.shape, generator=generator, dtype=p.dtype) for p in parameters])
    x = size.distance * torch.tensor([0.6, -0.8], dtype=torch.float64)
    speed = torch.linalg.vector_norm((A @ x + b)[:, 0], dim=-1).mean()
    assert float(speed) == pytest.approx(0.3 * size.speed, rel=0.02)
    assert bool(b.any()) == (goal is None)


@pytest.mark.parametrize("cls", [Homogeneous, Gaussian])
def test_a_policy_that_rests_has_no_shares(cls):
    policy = make_policy()
    policy.A.data.zero_()
    policy.b.data.zero_()
    with pytest.raises(
        InvalidArgumentError, match=r"the motion has to have a speed to explore a share of it, got 0\.0"
    ):
        cls.relative(policy, STARTS, T, DT)
