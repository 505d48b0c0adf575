"""Arms from their descriptions: against pytorch-kinematics and pinocchio; tests/train/hardware has them follow a motion."""

import functools

import numpy as np
import pytest
import torch

from tests.arms import ARMS
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError
from torchds.impedance import arm

mujoco = pytest.importorskip("mujoco")


@functools.cache
def made(name):
    return arm(ARMS[name].text, tool="tool")


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
