"""The coordinates in which explorations say how different two policies are, and sizes in shares of the motion."""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous, Stable, TrajectorySpace

START = torch.tensor([-1.2, 0.9], dtype=torch.float64)
T, DT = 40, 0.1


def make_policy(batch=(), Q=0):
    values = {
        "priors": [0.4, 0.6],
        "means": [[-0.9, 0.6], [0.5, -0.4]],
        "covariances": [[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]],
        "A": [[[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]],
        "b": [[0.3, -0.4], [0.5, -0.1]],
    }
    if Q:
        values |= {"stiffness_A": [[[0.0, 0.0]] * Q] * 2, "stiffness_b": [[20.0] * Q] * 2}
    policy = GMRPolicy(**{name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()})
    return policy.expand(*batch) if batch else policy


def changes_of(policy, n, size=1.0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return [size * torch.randn(n, *p.shape, generator=generator, dtype=torch.float64) for p in policy.parameters()]


def length(parts, n_batch=0):
    """(n, *batch)"""
    return torch.cat([part.flatten(1 + n_batch) for part in parts], -1).norm(dim=-1)


def test_the_length_is_how_far_the_motion_moves():
    """Root mean square over time of the displacement, in spreads, against roll-outs of slightly changed policies."""
    policy = make_policy((2,))
    policy.unpack(policy.pack() + torch.tensor([[0.0], [0.05]]))
    space = TrajectorySpace(policy, START, T, DT, 0.5)
    params, changes = list(policy.parameters()), changes_of(policy, 6, 1e-6)
    moved = GMRPolicy.expand(policy, 6)
    for p, change in zip(moved.parameters(), changes, strict=True):
        p.data = p.data + change
    with torch.no_grad():
        offset = rollout(moved, START, T, DT).x - rollout(policy, START, T, DT).x
    expected = offset[..., 1:, :].square().sum(-1).mean(-1).sqrt() / 0.5  # (6, 2)
    assert_close(length(space.measure(params, changes), 1), expected, rtol=1e-4, atol=0)


def test_distances_are_the_same_before_and_after_noise_is_drawn():
    policy = make_policy()
    space, params, changes = (
        TrajectorySpace(policy, START, T, DT, 0.5),
        list(policy.parameters()),
        changes_of(make_policy(), 3),
    )
    before = space.measure(params, changes)
    space(params, changes)
    assert all(torch.equal(a, b) for a, b in zip(before, space.measure(params, changes), strict=True))


def test_where_the_motion_diverges_distances_are_those_of_the_parameters():
    policy = make_policy()
    policy.A.data *= -1e4
    space = TrajectorySpace(policy, START, 300, DT, 0.5)
    changes = changes_of(policy, 3)
    assert_close(length(space.measure(list(policy.parameters()), changes)), length(changes))


def test_homogeneous_noise_is_measured_in_its_standard_deviations():
    policy = make_policy(Q=1)
    noise, params = Homogeneous(policy, 0.3), list(policy.parameters())
    normals = changes_of(policy, 4)
    back = dict(
        zip([name for name, _ in policy.named_parameters()], noise.measure(params, noise(params, normals)), strict=True)
    )
    drawn = dict(zip(back, normals, strict=True))
    assert_close(back["A"], drawn["A"])
    assert_close(back["b"], drawn["b"])
    assert not back["stiffness_b"].any()  # not explored


def test_others_measure_parameters_as_they_are_and_stable_noise_asks_what_is_behind_it():
    policy = make_policy()
    policy.A.data, policy.b.data = (
        -torch.eye(2, dtype=torch.float64).expand(2, 2, 2).clone(),
        torch.zeros_like(policy.b),
    )
    params, changes, goal = list(policy.parameters()), changes_of(policy, 3), torch.zeros(2, dtype=torch.float64)
    space = TrajectorySpace(policy, START, T, DT, 0.5, goal=goal)
    for noise in (Gaussian(0.1), Stable(policy, Gaussian(0.1), goal)):
        assert all(map(torch.equal, noise.measure(params, changes), changes))
    assert all(map(torch.equal, Stable(policy, space, goal).measure(params, changes), space.measure(params, changes)))


# ------------------------------------------------------------------ shares


@pytest.mark.parametrize("batch", [(), (3,)])
def test_sizes_are_shares_of_the_motion(batch):
    policy = make_policy(batch, Q=2)
    with torch.no_grad():
        path = rollout(make_policy(), START, T, DT)
    space = TrajectorySpace.relative(policy, START, T, DT, 0.1, speed=0.2, stiffness=0.3)
    x, v = path.x[1:].numpy(), path.v.numpy()
    extent = math.sqrt(((x - x.mean(0)) ** 2).sum(-1).sum() / (T - 1))
    np.testing.assert_allclose(space.spread.numpy(), [0.1 * extent] * 2, rtol=1e-12)
    noise = space._homogeneous
    assert noise.mean_speed == pytest.approx(0.2 * np.linalg.norm(v, axis=-1).mean())
    assert (noise.mean_stiffness, space.stiffness_spread) == pytest.approx((6.0, 6.0))


def test_the_unit_of_length_does_not_matter():
    """The same motion in metres and in millimetres, and the same normals."""
    metres, noise = make_policy(), []
    for unit in (1.0, 1e3):
        policy = GMRPolicy(
            metres.priors,
            unit * metres.means,
            unit**2 * metres.covariances,
            metres.A.detach(),
            unit * metres.b.detach(),
        )
        space = TrajectorySpace.relative(policy, unit * START, T, DT)
        A, b = space(list(policy.parameters()), changes_of(policy, 4))
        noise.append((A, b / unit))
    assert noise[0][0].abs().max() > 1e-3
    for parts in zip(*noise, strict=True):
        assert_close(*parts, rtol=1e-5, atol=1e-7)


def test_a_policy_that_rests_has_no_shares():
    policy = make_policy()
    policy.A.data.zero_()
    policy.b.data.zero_()
    with pytest.raises(InvalidArgumentError, match="has to be finite and positive"):
        TrajectorySpace.relative(policy, START, T, DT)
