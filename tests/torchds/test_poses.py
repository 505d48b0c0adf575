"""Orientation as rotation vectors: scipy's rotations are the second opinion."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

import torchds
from torchds import poses
from torchds.errors import InvalidArgumentError, InvalidDemonstrationsError, TorchdsError, UnknownNameError

EXACT = {"rtol": 0, "atol": 1e-12}


def turned(angles, generator=None):
    """Rotation vectors (len(angles), 3) of these lengths in random directions."""
    axis = torch.randn(len(angles), 3, generator=generator or torch.Generator().manual_seed(0), dtype=torch.float64)
    return torch.as_tensor(angles, dtype=torch.float64)[:, None] * axis / axis.norm(dim=-1, keepdim=True)


def scipy_quaternion(rotation):
    return torch.from_numpy(rotation.as_quat()[..., [3, 0, 1, 2]])


GOAL = scipy_quaternion(Rotation.from_rotvec([0.3, -1.2, 2.0]))
ANGLES = torch.cat([torch.tensor([0.0, 1e-300, 1e-12, 1e-6, 1e-3]), torch.linspace(0, math.pi, 200)[1:-1]]).double()


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_there_and_back(order):
    r = turned(ANGLES)
    goal = poses._in_order(GOAL, order)
    q = poses.quaternion(r, goal, order=order)
    assert_close(q.norm(dim=-1), torch.ones(len(r), dtype=r.dtype), **EXACT)
    assert_close(poses.rotation_vector(q, goal, order=order), r, **EXACT)
    assert torch.equal(poses.rotation_vector(-q, goal, order=order), poses.rotation_vector(q, goal, order=order))


def test_it_is_the_rotation_in_the_frame_of_the_goal_that_scipy_finds():
    r = turned(ANGLES)
    star = Rotation.from_quat(GOAL[[1, 2, 3, 0]].numpy())
    there = star * Rotation.from_rotvec(r.numpy())
    q = poses.quaternion(r, GOAL)
    assert_close((q * scipy_quaternion(there)).sum(-1).abs(), torch.ones(len(r), dtype=r.dtype), **EXACT)
    assert_close(
        poses.rotation_vector(3 * q, GOAL), torch.from_numpy((star.inv() * there).as_rotvec()), rtol=0, atol=1e-11
    )


def test_the_matrix_is_that_of_scipy():
    r = turned(ANGLES)
    expected = Rotation.from_quat(GOAL[[1, 2, 3, 0]].numpy()) * Rotation.from_rotvec(r.numpy())
    for order in ("wxyz", "xyzw"):
        matrix = poses.matrix(r, poses._in_order(GOAL, order), order=order)
        assert_close(matrix, torch.from_numpy(expected.as_matrix()), **EXACT)


def test_a_turn_of_pi_has_one_vector_for_both_signs():
    q = torch.tensor([0.0, 0.0, -1.0, 0.0], dtype=torch.float64)
    one = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    assert_close(poses.rotation_vector(q, one), torch.tensor([0.0, math.pi, 0.0], dtype=torch.float64), **EXACT)
    assert torch.equal(poses.rotation_vector(q, one), poses.rotation_vector(-q, one))


def test_gradients_are_finite_and_right_everywhere():
    r = turned([0.0, 1e-9, 0.29, 0.31, 3.1]).requires_grad_()
    assert torch.autograd.gradcheck(lambda r: poses.rotation_vector(poses.quaternion(r, GOAL), GOAL), (r,))
    zero = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(lambda r: poses.quaternion(r, GOAL), zero)
    assert_close(jacobian.mT @ jacobian, 0.25 * torch.eye(3, dtype=torch.float64), **EXACT)


def test_the_angular_velocity_is_that_of_the_motion():
    """Ṙ Rᵀ = [ω]×, with Ṙ by autograd through rotation matrices."""
    r, rate = turned([0.0, 1e-8, 1e-3, 0.2999, 0.3001, 1.0, 3.0]), turned(7 * [1.5], torch.Generator().manual_seed(1))

    def matrix(r):
        w, x, y, z = poses.quaternion(r, GOAL).unbind(-1)
        rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
        rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
        rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
        return torch.stack(rows, -1).unflatten(-1, (3, 3))

    jacobian = torch.autograd.functional.jacobian(lambda r: matrix(r).sum(0), r)  # (3, 3, n, 3): each R has its own r
    spin = torch.einsum("abnd,nd->nab", jacobian, rate) @ matrix(r).mT
    expected = torch.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)
    assert_close(poses.angular_velocity(r, rate, GOAL), expected, **EXACT)


def recording(signs=1.0, start=2.6, n=80):
    """A place and an orientation (n, 4) that comes to GOAL from `start` [rad] away."""
    t = torch.linspace(0, 1, n, dtype=torch.float64)[:, None]
    r = start * (1 - t) ** 2 * torch.tensor([[0.6, 0.0, -0.8]], dtype=torch.float64)
    return torch.cat([1 - t, t**2 - t, t - 1], -1), signs * poses.quaternion(r, GOAL), r


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_single_precision_ends_at_its_goal_and_other_shapes_are_refused(order):
    one = torch.tensor([1.0, 0, 0, 0])[[0, 1, 2, 3] if order == "wxyz" else [1, 2, 3, 0]]
    assert poses.rotation_vector(one, one, order=order).tolist() == [0.0, 0.0, 0.0]
    p, q = np.zeros((5, 3), np.float32), one.expand(5, 4).numpy()
    assert poses.from_poses([p], [q], 0.1, order=order)[0].x.tolist() == [[0.0] * 6] * 5
    for refused in (
        lambda: poses.rotation_vector(one[:3], one, order=order),
        lambda: poses.quaternion([0.0] * 3, one[:3], order=order),
        lambda: poses.last_orientation([q[:, :3]], order=order),
        lambda: poses.from_poses([p], [q], 0.1, one[:3], order=order),
        lambda: poses.from_poses([p], [q[:, :3]], 0.1, order=order),
    ):
        with pytest.raises(TorchdsError, match=r"4"):
            refused()


def test_demonstrations_are_the_rotation_vectors_whatever_the_signs():
    p, q, r = recording()
    flips = torch.where(torch.rand(len(q), 1, generator=torch.Generator().manual_seed(0)) < 0.5, -1.0, 1.0).double()
    for signs in (torch.ones_like(flips), -torch.ones_like(flips), flips):
        demos = poses.from_poses([p, p], [signs * q, q], dt=0.02)
        assert_close(demos[0].x, torch.cat([p, r], -1), rtol=0, atol=1e-11)
        assert_close(demos[0].x, demos[1].x, **EXACT)
    assert demos.names == ("x", "y", "z", "rx", "ry", "rz") and demos.units == ("m",) * 3 + ("rad",) * 3
    other = poses.from_poses([p], [q[:, [1, 2, 3, 0]].numpy()], 0.02, GOAL[[1, 2, 3, 0]], order="xyzw")
    assert_close(other[0].x, demos[1].x, rtol=0, atol=1e-11)


def test_a_motion_may_begin_half_a_turn_away_with_rounded_numbers():
    p, q, _ = recording(start=math.pi)
    r = poses.from_poses([p], [q.float().double() / q.float().double().norm(dim=-1, keepdim=True)], 0.02)[0].x[:, 3:]
    assert abs(float(r[0].norm()) - math.pi) < 1e-6 and float(r.diff(dim=0).norm(dim=-1).max()) < 0.1


def test_the_default_goal_is_the_mean_of_the_ends_whatever_the_signs():
    ends = torch.stack([poses.quaternion(torch.tensor([0.0, 0.0, a], dtype=torch.float64), GOAL) for a in (-0.2, 0.2)])
    mean = poses.last_orientation([ends[:1], -ends[1:]])
    assert abs(float((mean * GOAL).sum())) == pytest.approx(1, abs=1e-12)


def test_what_is_no_pose_is_refused():
    p, q, _ = recording()
    for bad, words in (
        (2 * q, r"demonstration 0, row 0: a quaternion has to have norm 1, got"),
        (q[:, :3], "position has to have 3 columns and quaternion 4, got 3 and 3"),
        (recording(start=4.0)[1], "demonstration 0, row 0: it is 229° away from its goal, .* at most 180°"),
    ):
        with pytest.raises(InvalidDemonstrationsError, match=words):
            poses.from_poses([p], [bad], dt=0.02)
    with pytest.raises(UnknownNameError, match="unknown order 'zyxw'"):
        poses.from_poses([p], [q], 0.02, order="zyxw")
    with pytest.raises(InvalidArgumentError, match="4 numbers"):
        poses.from_poses([p], [q], 0.02, goal=torch.zeros(3))
    with pytest.raises(InvalidArgumentError, match="norm above zero"):
        poses.rotation_vector(torch.zeros(4), GOAL)
    with pytest.raises(InvalidArgumentError, match=r"x has to end with the three of the rotation, got shape \(2,\)"):
        poses.quaternion(torch.zeros(2), GOAL)


@pytest.mark.slow
def test_a_certified_motion_of_poses_ends_at_the_goal_from_anywhere_within_150_degrees():
    generator = torch.Generator().manual_seed(3)
    raw = torch.randn(4, 6, 6, generator=generator, dtype=torch.float64)
    A = -0.2 * raw @ raw.mT - torch.eye(6, dtype=torch.float64) + 0.5 * (raw - raw.mT)
    goal = torch.tensor([0.4, 0.1, 0.3, 0.0, 0.0, 0.0], dtype=torch.float64)
    policy = torchds.GMRPolicy(
        torch.ones(4) / 4, torch.randn(4, 6, generator=generator), torch.eye(6).repeat(4, 1, 1), A, -A @ goal
    )
    assert policy.certificate(goal).stable
    r = turned(np.radians(150) * torch.rand(1000, generator=generator, dtype=torch.float64), generator)
    x0 = torch.cat([torch.randn(1000, 3, generator=generator, dtype=torch.float64), r], -1)
    with torch.no_grad():
        end = torchds.rollout(policy, x0, 600, 0.02).x[:, -1]
    assert_close(end[:, :3], goal[:3].expand(1000, 3), rtol=0, atol=1e-4)
    assert float((poses.quaternion(end, GOAL) * GOAL).sum(-1).abs().min()) > 1 - 1e-8


@pytest.mark.slow
def test_a_fit_learns_a_pose():
    p, q, _ = recording(start=2.0)
    demos = poses.from_poses([p, p], [q, -q], dt=1 / 79)
    fit = torchds.fit_stable(demos, n_components=2, n_steps=30)
    assert fit.certificate().stable and fit.policy.input_dim == 6
