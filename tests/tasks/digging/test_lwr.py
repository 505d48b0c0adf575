"""The arm: pytorch-kinematics, MuJoCo, pin and products of rotations by hand agree on one description."""

import math

import pytest
import torch

from torchds.errors import InvalidArgumentError

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

import numpy as np  # noqa: E402

from tasks.digging import lwr  # noqa: E402


@pytest.fixture(scope="module")
def arm():
    model = lwr.spec().compile()
    return model, mujoco.MjData(model)


@pytest.fixture(scope="module")
def poses():
    """200 postures all over the joint limits."""
    limit = torch.tensor([math.radians(link.limit) for link in lwr.LINKS], dtype=torch.float64)
    return limit * (2 * torch.rand(200, 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 1)


def by_hand(q):
    """Tool position, rotation and Jacobian from rotations about the axes, all postures at once."""
    R = torch.eye(3, dtype=q.dtype).expand(len(q), 3, 3)
    p, origins, axes = q.new_zeros(len(q), 3), [], []
    for i, link in enumerate(lwr.LINKS):
        p = p + link.offset * R[..., 2]
        axis = q.new_tensor(link.axis)
        x, y, z = axis.tolist()
        cross = q.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        origins.append(p)
        axes.append(R @ axis)
        R = R @ torch.linalg.matrix_exp(q[:, i, None, None] * cross)
    p = p + lwr.TOOL_REACH * R[..., 2]
    # The blade turns away from the flange's axis by 50 degrees: z of the flange is (cos 50, 0, −sin 50) in the blade's frame.
    c, s = math.cos(lwr.TOOL_ANGLE), math.sin(lwr.TOOL_ANGLE)
    R = R @ q.new_tensor([[-s, 0, -c], [0, 1, 0], [c, 0, -s]])
    J = torch.stack([torch.cat([torch.linalg.cross(a, p - o), a], -1) for a, o in zip(axes, origins, strict=True)], -1)
    return p, R, J


@pytest.mark.slow
def test_kinematics_and_jacobian_agree_with_mujoco_and_with_a_third_way(arm, poses):
    model, data = arm
    J, pose = lwr.chain().jacobian(poses, ret_eef_pose=True)
    p, R, by_hand_J = by_hand(poses)
    site = model.site("tool").id
    for i, q in enumerate(poses):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobian = np.zeros((6, 7))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        for position, rotation, other, tolerance in (
            (pose[i, :3, 3], pose[i, :3, :3], J[i], 1e-6),
            (p[i], R[i], by_hand_J[i], 1e-12),
        ):
            np.testing.assert_allclose(position, data.site_xpos[site], atol=tolerance)
            np.testing.assert_allclose(rotation, data.site_xmat[site].reshape(3, 3), atol=tolerance)
            np.testing.assert_allclose(other, jacobian, atol=tolerance)


@pytest.mark.slow
def test_gravity_and_mass_matrix_agree_with_pin(arm, poses):
    pin = pytest.importorskip("pinocchio")
    model, data = arm
    other = pin.buildModelFromXML(lwr.urdf())
    assert list(other.names)[1:] == list(lwr.JOINTS)
    scratch = other.createData()
    armature = np.diag([link.armature for link in lwr.LINKS])
    for q in poses.numpy():
        data.qpos[:], data.qvel[:] = q, 0.0
        mujoco.mj_forward(model, data)
        M = np.zeros((7, 7))
        mujoco.mj_fullM(model, data, M)
        upper = np.triu(pin.crba(other, scratch, q))
        np.testing.assert_allclose(M, upper + np.triu(upper, 1).T + armature, atol=1e-10)
        np.testing.assert_allclose(data.qfrc_bias, pin.computeGeneralizedGravity(other, scratch, q), atol=1e-10)


def test_the_bias_of_a_moving_arm_agrees_with_pin(arm, poses):
    pin = pytest.importorskip("pinocchio")
    model, data = arm
    other = pin.buildModelFromXML(lwr.urdf())
    scratch = other.createData()
    for q, v in zip(poses.numpy(), poses.flip(0).numpy(), strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_bias, pin.nonLinearEffects(other, scratch, q, v), atol=1e-10)


def test_mujoco_reads_limits_efforts_and_masses(arm):
    model, _ = arm
    np.testing.assert_allclose(np.degrees(model.jnt_range[:, 1]), [link.limit for link in lwr.LINKS])
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], lwr.EFFORTS)
    assert model.body("shovel").mass == pytest.approx(lwr.SHOVEL_MASS)
    assert model.body_mass.sum() == pytest.approx(14.4 + lwr.BASE_MASS + lwr.GRIPPER_MASS + lwr.SHOVEL_MASS)


def test_a_posture_holds_the_tool_where_it_should():
    x, z, angle = torch.tensor([[0.59, 0.735, 0.785], [0.235, 0.05, 0.26], [-0.65, -0.60, 0.28]], dtype=torch.float64)
    p, R, _ = by_hand(lwr.posture(x, z, angle))
    torch.testing.assert_close(p, torch.stack([x, torch.zeros_like(x), z], -1), atol=1e-12, rtol=0)
    torch.testing.assert_close(torch.atan2(R[:, 2, 0], R[:, 0, 0]), angle, atol=1e-12, rtol=0)


def test_what_is_out_of_reach_is_refused():
    far = torch.tensor(1.5, dtype=torch.float64)
    with pytest.raises(InvalidArgumentError, match="does not reach"):
        lwr.posture(far, far, far)


def test_reach_is_where_a_posture_is():
    x, z = torch.meshgrid(torch.linspace(0.2, 1.4, 9), torch.linspace(-0.2, 1.2, 9), indexing="ij")
    angle = torch.zeros_like(x)
    reached = lwr.reaches(x, z, angle)
    assert 10 < reached.sum() < 70
    lwr.posture(x[reached], z[reached], angle[reached])
    for i in torch.nonzero(~reached):
        with pytest.raises(InvalidArgumentError, match="does not reach"):
            lwr.posture(x[tuple(i)], z[tuple(i)], angle[tuple(i)])
    assert not lwr.reaches(torch.tensor(float("nan")), torch.tensor(0.2), torch.tensor(0.0))
