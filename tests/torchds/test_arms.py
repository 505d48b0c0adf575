"""Arms from their descriptions: against pytorch-kinematics and pinocchio, and behind a learned motion of poses in MuJoCo."""

import functools
import math

import numpy as np
import pytest
import torch

import torchds
import torchds.arm_law
from tests.arms import ARMS
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError
from torchds.impedance import PoseReference, arm

mujoco = pytest.importorskip("mujoco")

START = torch.tensor([-0.12, -0.2, 0.1, 0.4, -0.5, 0.6], dtype=torch.float64)  # from the goal, 50 degrees turned
DT = 0.001


@functools.cache
def made(name):
    return arm(ARMS[name].text, tool="tool")


@functools.cache
def motion():
    """A motion of poses that ends at zero, learned from three curved demonstrations of two seconds."""
    t = torch.linspace(0, 1, 41, dtype=torch.float64)[:, None]
    s = 1 - t**3 * (10 - 15 * t + 6 * t**2)
    curve = torch.sin(math.pi * s) * torch.tensor([0.03, -0.02, 0.05, 0.1, 0.1, -0.1], dtype=torch.float64)
    demos = torchds.Demonstrations([s * START * share + curve for share in (0.9, 1.0, 1.1)], dt=0.05)
    return torchds.GMRPolicy.from_demonstrations(demos, n_components=2).requires_grad_(False)


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_kinematics_are_those_of_pytorch_kinematics(name, randn):
    pk = pytest.importorskip("pytorch_kinematics")
    theirs = pk.build_serial_chain_from_urdf(ARMS[name].text, "tool").to(dtype=torch.float64)
    q = randn(20, len(made(name).joints))
    for ours, other in zip(made(name).chain.jacobian(q), theirs.jacobian(q, ret_eef_pose=True), strict=True):
        torch.testing.assert_close(ours, other, atol=1e-6, rtol=0)  # which rounds the offsets to float32


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_mass_and_bias_are_those_of_pinocchio(name, randn):
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromXML(ARMS[name].text)
    scratch = model.createData()
    q, v = randn(2, 5, len(made(name).joints))
    mass, bias = made(name).dynamics(q, v)
    for i in range(5):
        upper = np.triu(pin.crba(model, scratch, q[i].numpy()))
        np.testing.assert_allclose(mass[i], upper + np.triu(upper, 1).T, atol=1e-10)
        np.testing.assert_allclose(bias[i], pin.nonLinearEffects(model, scratch, q[i].numpy(), v[i].numpy()), atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_limits_and_names_are_read(name):
    mine, d = made(name), ARMS[name]
    assert mine.joints == tuple(f"joint{i + 1}" for i in range(len(d.masses)))
    assert mine.torque_limit.tolist() == list(d.efforts)
    assert mine.range.tolist() == [[-d.limit, d.limit]] * len(d.masses)
    assert mine.impedance(d.goal).torque_limit.tolist() == list(d.efforts)


def reached(mine, q, pose):
    """The joint angles near q at which the tool has a pose, by Newton's method."""
    for _ in range(60):
        J, now = (part[0] for part in mine.chain.jacobian(q[None]))
        turn = torchds.arm_law.rotation_vector(pose[:3, :3] @ now[:3, :3].T)
        error = torch.cat([pose[:3, 3] - now[:3, 3], turn])
        q = q + 0.5 * torch.linalg.pinv(J, rtol=1e-3) @ error
    assert float(error.norm()) < 1e-6
    return q


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_each_arm_follows_a_learned_motion_of_poses(name):
    """Less than 5 mm and a degree behind, and at the goal in the end; no torque is cut, and the hand does not flip."""
    mine, policy = made(name), motion()
    rest = torch.tensor(ARMS[name].goal, dtype=torch.float64)
    end = mine.chain.jacobian(rest[None])[1][0]
    goal = quaternion_of(end[:3, :3])
    shift = torch.cat([end[:3, 3], torch.zeros(3)])
    path = torchds.rollout(policy, START, 3000, DT)
    reference = PoseReference.of(path.x + shift, torch.cat([path.v, path.v[-1:]]), goal)
    first = torch.eye(4, dtype=torch.float64)
    first[:3, :3], first[:3, 3] = reference.rotation[0], reference.x[0]
    q = reached(mine, rest, first)
    control = mine.impedance(q, rotation_scale=0.02)
    data = mujoco.MjData(mine.model)
    data.qpos[mine.qpos] = q
    mine.model.opt.timestep = DT
    mujoco.mj_forward(mine.model, data)
    errors, full = [], np.zeros((mine.model.nv, mine.model.nv))
    for k in range(3000):
        mujoco.mj_fullM(mine.model, data, full)
        state = data.qpos[mine.qpos], data.qvel[mine.dofs], full[np.ix_(mine.dofs, mine.dofs)]
        asked = control(*state, data.qfrc_bias[mine.dofs], PoseReference(*(part[k] for part in reference)), 2000.0)
        assert not asked.saturated.any(), k
        errors.append(asked.error)
        data.qfrc_applied[mine.dofs] = asked.torque
        mujoco.mj_step(mine.model, data)
        mujoco.mj_forward(mine.model, data)
    distance, angle = (torch.linalg.vector_norm(part, dim=-1) for part in torch.stack(errors).split(3, -1))
    assert float(distance.max()) < 0.005
    assert math.degrees(float(angle.max())) < 1.0
    _, pose = mine.chain.jacobian(torch.from_numpy(data.qpos[mine.qpos])[None])
    assert float((pose[0, :3, 3] - end[:3, 3]).norm()) < 0.02
    assert math.degrees(float(torchds.arm_law.rotation_vector(end[:3, :3] @ pose[0, :3, :3].T).norm())) < 5


def quaternion_of(rotation):
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, rotation.numpy().ravel())
    return torch.from_numpy(q)


def test_fingers_are_held_and_a_body_is_a_tool_too(randn):
    mine = made("iiwa")
    assert mine.model.nv == 9 and mine.dofs.tolist() == list(range(7))
    other = arm(ARMS["iiwa"].text, tool="link7")
    q = randn(3, 7)
    (_, tool), (_, body) = mine.chain.jacobian(q), other.chain.jacobian(q)
    torch.testing.assert_close(tool[:, :3, 3] - body[:, :3, 3], 0.126 * body[:, :3, 2], atol=1e-12, rtol=0)


def test_a_spec_a_model_and_a_file_are_arms_too(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARMS["ur5"].text)
    (tmp_path / "arm.xml").write_text(ARMS["iiwa"].text)
    assert arm(tmp_path / "arm.urdf").joints == made("ur5").joints  # there is one end
    spec = mujoco.MjSpec.from_file(str(tmp_path / "arm.xml"))
    for given in (tmp_path / "arm.xml", spec, spec.compile()):
        torch.testing.assert_close(arm(given, "tool").chain.axes, made("iiwa").chain.axes)


def test_a_joint_with_a_reference_and_an_anchor_elsewhere(randn):
    """MuJoCo's `pos` and `ref` of a joint; the tool as MuJoCo has it."""
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><body pos="0 0 1" euler=".1 .2 .3">'
        '<joint axis="0 1 0" pos=".2 0 .1" ref=".4"/><geom size=".1"/><body pos=".3 0 0"><joint type="slide" axis="1 1 0"/>'
        '<geom size=".1"/><site name="end" pos=".1 .2 .3" euler=".3 0 0"/></body></body></worldbody></mujoco>'
    )
    mine = arm(text, tool="end")
    data = mujoco.MjData(mine.model)
    for q in randn(5, 2):
        data.qpos[:] = q
        mujoco.mj_kinematics(mine.model, data)
        _, pose = mine.chain.jacobian(q[None])
        np.testing.assert_allclose(pose[0, :3, 3], data.site_xpos[0], atol=1e-12)
        np.testing.assert_allclose(pose[0, :3, :3], data.site_xmat[0].reshape(3, 3), atol=1e-12)
    assert not bool(mine.range.isfinite().any()) and mine.impedance([0.0, 0.0]).torque_limit is None


def test_what_is_no_arm_is_refused(tmp_path, monkeypatch):
    two_ends = '<mujoco><worldbody><body name="a"><joint/><geom size=".1"/></body><body name="b"/></worldbody></mujoco>'
    free = '<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    with pytest.raises(InvalidArgumentError, match="there are 2 ends; give tool= one of a, b"):
        arm(two_ends)
    with pytest.raises(InvalidArgumentError, match="there is no 'c'; give tool= one of a, b"):
        arm(two_ends, "c")
    with pytest.raises(InvalidArgumentError, match="fix the base of the arm"):
        arm(free)
    with pytest.raises(InvalidArgumentError, match=r"there has to be one, got \(\)"):
        arm(two_ends, "b")
    with pytest.raises(FileError, match=r"arm\.urdf cannot be read"):
        arm(tmp_path / "arm.urdf")
    with pytest.raises(FileError, match="the text is no URDF or MJCF that MuJoCo reads"):
        arm("<mujoco><arm/></mujoco>")
    with pytest.raises(InvalidArgumentError, match=r"q and v have to be \(\.\.\., 6\)"):
        made("ur5").dynamics(torch.zeros(5), torch.zeros(6))
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(MissingPackageError, match="mujoco"):
        arm(two_ends)
