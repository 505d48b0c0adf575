"""The rotation vector of a rotation; the law itself is tested as the controller's, in test_cartesian."""

import math

import pytest
import torch

from torchds.arm_law import rotation_vector


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1.0, math.pi - 1e-3])
def test_the_vector_of_a_rotation_is_exact(angle, randn):
    axis = torch.nn.functional.normalize(randn(5, 3), dim=-1)
    hat = torch.stack([torch.linalg.cross(axis, e.expand(5, 3)) for e in torch.eye(3, dtype=torch.float64)], -1)
    turn = torch.linalg.matrix_exp(angle * hat)
    torch.testing.assert_close(rotation_vector(turn), angle * axis, atol=1e-9, rtol=0)
