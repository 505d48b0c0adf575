"""Screws against a product of matrix exponentials, and Jacobians against differences."""

import pytest
import torch

from tests.torchds.kernels.test_arm import screws
from torchds.errors import InvalidArgumentError
from torchds.kinematics import Screws, with_tool


def exponential(axis, q):
    v, w = axis[:3], axis[3:]
    twist = torch.zeros(4, 4, dtype=torch.float64)
    twist[:3, :3] = torch.stack([torch.linalg.cross(w, column) for column in torch.eye(3, dtype=torch.float64)], -1)
    twist[:3, 3] = v
    return torch.linalg.matrix_exp(q * twist)


@pytest.mark.parametrize("slides", [(), (1, 3)])
def test_the_pose_is_the_product_of_exponentials(randn, slides):
    arm, q = screws(randn, slides, 4), randn(5, 4)
    _, pose = arm.jacobian(q)
    for i in range(5):
        expected = arm.home
        for j in reversed(range(4)):
            expected = exponential(arm.axes[:, j], q[i, j]) @ expected
        torch.testing.assert_close(pose[i], expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("tool", [False, True])
def test_the_jacobian_is_the_derivative_of_the_pose(randn, tool):
    arm, q, h = screws(randn, (2,), 4), randn(3, 4), 1e-6
    end = arm.jacobian(randn(1, 4))[1][0] if tool else torch.eye(4, dtype=torch.float64)

    def at(q):
        return with_tool(*arm.jacobian(q), end)

    J, pose = at(q)
    for j in range(4):
        step = torch.zeros(4, dtype=torch.float64)
        step[j] = h
        rate = (at(q + step)[1] - at(q - step)[1]) / (2 * h)
        torch.testing.assert_close(J[:, :3, j], rate[:, :3, 3], atol=1e-8, rtol=0)
        spin = rate[:, :3, :3] @ pose[:, :3, :3].mT
        turned = torch.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)
        torch.testing.assert_close(J[:, 3:, j], turned, atol=1e-8, rtol=0)


def test_screws_are_found_from_any_chain(randn):
    arm = screws(randn, (1,), 5)
    again = Screws.of(arm, 5)
    torch.testing.assert_close(again.axes, arm.axes, atol=1e-12, rtol=0)

    class Bent:
        dtype = torch.float64

        def jacobian(self, th, *, ret_eef_pose):
            J, pose = arm.jacobian(th)
            return J * (1 + th[:, :1, None] ** 2), pose

    assert Screws.of(Bent(), 5) is None


def test_what_are_no_screws_is_refused(randn):
    with pytest.raises(InvalidArgumentError, match=r"axes have to be \(6, J\) and home \(4, 4\), got \(3, 2\)"):
        Screws(randn(3, 2), torch.eye(4))
    with pytest.raises(InvalidArgumentError, match=r"has to have length 1, or 0 for a joint that slides, got \[2\.0\]"):
        Screws(torch.tensor([[0, 0, 0, 0, 0, 2.0]]).T, torch.eye(4))
