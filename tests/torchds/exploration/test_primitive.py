"""Noise of primitives: how far it moves the motion."""

import pytest
import torch

from torchds.dmp import DMP
from torchds.exploration.primitive import Along, alike, extent

MOTION = (torch.zeros(2, dtype=torch.float64), 60, 0.05)


@pytest.fixture(scope="module")
def primitive():
    generator = torch.Generator().manual_seed(0)
    goal = torch.tensor([2.0, 1.0], dtype=torch.float64)
    return DMP(20 * torch.randn(6, 2, dtype=torch.float64, generator=generator), goal, 3.0)


def moved(primitive, exploration, n=4000):
    """Root mean square distances `(n,)` over time by which noise moves the motion."""
    parameters = list(primitive.parameters())
    generator = torch.Generator().manual_seed(1)
    noise = exploration(parameters, [torch.randn(n, *p.shape, dtype=p.dtype, generator=generator) for p in parameters])
    assert noise[1].abs().max() == 0
    perturbed = primitive.expand(n)
    perturbed.A.data += noise[0]
    difference = perturbed.rollout(*MOTION).x[:, 1:] - primitive.rollout(*MOTION).x[1:]
    return difference.square().sum(-1).mean(-1).sqrt().detach(), noise


def test_noise_of_one_size_moves_the_motion_by_its_share(primitive):
    distance, noise = moved(primitive, alike(primitive, *MOTION, 0.2))
    assert float(distance.square().mean().sqrt()) == pytest.approx(0.2 * extent(primitive, *MOTION), rel=0.05)
    std = noise[0].std(0)
    assert std.max() / std.min() < 1.2


def test_along_the_motion_each_direction_moves_it_as_far(primitive):
    """Without damping the mean square is spread² for each of the 12 weights."""
    distance, _ = moved(primitive, Along(primitive, *MOTION[1:], 0.1, damping=0.0))
    assert float(distance.square().mean()) == pytest.approx(12 * 0.1**2, rel=0.05)
    relative = moved(primitive, Along.relative(primitive, *MOTION, 0.1))[0]
    same = moved(primitive, Along(primitive, *MOTION[1:], 0.1 * extent(primitive, *MOTION)))[0]
    assert torch.equal(relative, same)


def test_the_measure_is_how_far_the_motion_moves(primitive):
    along = Along(primitive, *MOTION[1:], 0.1)
    distance, noise = moved(primitive, along, 5)
    (measured, _) = along.measure(list(primitive.parameters()), noise)
    length = measured.flatten(1).norm(dim=-1)
    torch.testing.assert_close(length * 0.1, distance, rtol=1e-9, atol=0)
