"""References of tools: a pose from a state of a motion, and the plane in space."""

import pytest
import torch

from torchds import poses
from torchds.targets import Plane, PlaneReference, PoseReference


def test_a_pose_reference_has_the_rotation_and_the_rate_of_its_state(randn):
    x, v, goal, h = 0.5 * randn(7, 6), randn(7, 6), randn(4), 1e-6
    reference = PoseReference.of(x, v, goal)
    ahead, behind = (poses.matrix(x + s * h * v, goal) for s in (1, -1))
    spin = (ahead - behind) / (2 * h) @ reference.rotation.mT
    turned = torch.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)
    torch.testing.assert_close(reference.rate, turned, atol=1e-7, rtol=0)
    assert torch.equal(reference.x, x[:, :3]) and torch.equal(reference.v, v[:, :3])


@pytest.mark.parametrize("name", ["xy", "yz", "xz"])
def test_the_plane_reads_what_it_writes(name, randn):
    plane = Plane(name, 0.3)
    reference = PlaneReference(randn(5, 2), randn(5), randn(5, 2), randn(5))
    x, rotation, _, rate = plane.pose(reference)
    pose = torch.zeros(5, 4, 4, dtype=torch.float64)
    pose[:, :3, :3], pose[:, :3, 3] = rotation, x
    position, angle = plane.state(pose)
    torch.testing.assert_close(position, reference.x)
    torch.testing.assert_close(angle, reference.angle)
    assert (x[:, plane.normal] == 0.3).all() and torch.allclose(torch.det(rotation), torch.ones(5).double())
    turning = plane.pose(reference._replace(angle=reference.angle + 1e-6 * reference.rate)).rotation - rotation
    spin = 1e6 * turning @ rotation.mT
    torch.testing.assert_close(rate, torch.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1), atol=1e-5, rtol=0)


def test_the_turn_is_that_of_the_poses(randn):
    plane = Plane("xz", 0.0)
    reference = PlaneReference(randn(4, 2), randn(4), randn(4, 2), randn(4))
    pose = torch.zeros(4, 4, 4, dtype=torch.float64)
    pose[:, :3, :3] = torch.linalg.qr(randn(4, 3, 3))[0]
    expected = plane.pose(reference).rotation @ pose[:, :3, :3].mT
    torch.testing.assert_close(plane.turn(pose, reference), expected)
