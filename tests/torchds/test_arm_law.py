"""The rotation vector of a rotation; the law itself is tested as the controller's, in test_cartesian."""

import math

import pytest
import torch

from torchds.arm_law import rotation_vector


def test_the_vector_of_half_a_turn_is_as_long_as_any_other(randn):
    axis = torch.nn.functional.normalize(torch.cat([randn(50, 3), torch.eye(3, dtype=torch.float64)]), dim=-1)
    turn = 2 * axis.unsqueeze(-1) * axis.unsqueeze(-2) - torch.eye(3, dtype=torch.float64)
    found = rotation_vector(turn) / math.pi
    torch.testing.assert_close((found * axis).sum(-1).abs(), torch.ones(53, dtype=torch.float64), atol=1e-12, rtol=0)
    torch.testing.assert_close(found.norm(dim=-1), torch.ones(53, dtype=torch.float64), atol=1e-12, rtol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1.0, math.pi - 1e-3])
def test_the_vector_of_a_rotation_is_exact(angle, randn):
    axis = torch.nn.functional.normalize(randn(5, 3), dim=-1)
    hat = torch.stack([torch.linalg.cross(axis, e.expand(5, 3)) for e in torch.eye(3, dtype=torch.float64)], -1)
    turn = torch.linalg.matrix_exp(angle * hat)
    torch.testing.assert_close(rotation_vector(turn), angle * axis, atol=1e-9, rtol=0)
