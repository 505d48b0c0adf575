"""The whole way: own recordings of poses, a stable motion, one file, and an arm that follows it without torch."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import torchds
from tests.arms import classic, mjcf
from tests.without_torch import WITHOUT_TORCH

pytest.importorskip("mujoco")
ROOT = Path(__file__).parents[2]
HEADER = "time [s],x [m],y [m],z [m],qx,qy,qz,qw"
SECONDS = 10.0
POSTURE = [0.1, 0.5, 0.1, -1.5, 0.1, 1.1, 0.2]

ROBOT = (
    WITHOUT_TORCH
    + """import mujoco
import numpy as np
from torchds import Controller

given = json.load(open(sys.argv[1]))
model = mujoco.MjModel.from_xml_string(given["arm"])
model.opt.timestep = 0.001
data = mujoco.MjData(model)
goal, n, tool = np.array(given["goal"]), 7, 0
K, D = np.array([1500.0] * 3 + [200.0] * 3), np.array([150.0] * 3 + [12.0] * 3)


def orientation(x):
    "q* exp(r/2)"
    turn, q, angle = np.empty(4), np.empty(4), np.linalg.norm(x[3:])
    mujoco.mju_axisAngle2Quat(turn, x[3:] / max(angle, 1e-12), angle)
    mujoco.mju_mulQuat(q, goal, turn)
    return q


def look(x):
    "Jacobian (6, n) of the tool, and the error of its pose: metres, then the rotation vector in the base frame."
    J, q, turn = np.zeros((6, model.nv)), np.empty(4), np.empty(3)
    mujoco.mj_jacSite(model, data, J[:3], J[3:], tool)
    mujoco.mju_mat2Quat(q, data.site_xmat[tool])
    mujoco.mju_subQuat(turn, orientation(x), q)
    return J[:, :n], np.concatenate([x[:3] - data.site_xpos[tool], data.site_xmat[tool].reshape(3, 3) @ turn])


controller = Controller.load(sys.argv[2], clock=lambda: data.time)  # the simulated time
start = np.array(given["start"])
controller.reset(start)
data.qpos[:n] = given["posture"]
for _ in range(200):  # stand where the motion begins
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    J, error = look(start)
    data.qpos[:n] += 0.3 * np.linalg.pinv(J) @ error
begun = float(np.abs(error).max())
posture, M, off, cut = data.qpos[:n].copy(), np.zeros((model.nv, model.nv)), [], False
limit, saturated, x = model.actuator_ctrlrange[:, 1], False, start
for _ in range(round(given["seconds"] / 0.001)):
    before, tick = x, controller.step()
    x, cut = tick.x.copy(), cut or bool(tick.cut)
    spin = np.empty(3)
    mujoco.mju_subQuat(spin, orientation(x), orientation(before))
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, orientation(before))
    wanted = np.concatenate([(x - before)[:3], R.reshape(3, 3) @ spin]) / 0.001
    mujoco.mj_step1(model, data)
    J, error = look(x)
    mujoco.mj_fullM(model, data, M)
    v = data.qvel[:n]
    inverse = np.linalg.inv(M[:n, :n])
    dual = inverse @ J.T @ np.linalg.inv(J @ inverse @ J.T)
    rest = 5.0 * (posture - data.qpos[:n]) - 2.0 * v
    torque = J.T @ (K * error + D * (wanted - J @ v)) + data.qfrc_bias[:n] + rest - J.T @ (dual.T @ rest)
    saturated = saturated or bool((np.abs(torque) > limit).any())
    data.ctrl[:] = torque
    mujoco.mj_step2(model, data)
    off.append([np.linalg.norm(error[:3]), np.linalg.norm(error[3:])])
print(json.dumps({
    "begun": begun, "off": np.max(off, 0).tolist(), "end": x.tolist(), "tool": data.site_xpos[tool].tolist(),
    "cut": cut, "saturated": saturated, "late": controller.late, "torch": "torch" in sys.modules,
}))
"""
)


def recorded(folder):
    """Three recordings of a hand that comes down and turns, at 50 Hz; the sign of the quaternion flips now and then."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 4, 201)
    for k in range(3):
        s = (1 - np.clip(t / 3.6, 0, 1)) ** 3 * (1 + 3 * np.clip(t / 3.6, 0, 1) + 6 * np.clip(t / 3.6, 0, 1) ** 2)
        place = np.array([0.58, 0.08, 0.38]) + s[:, None] * np.array([-0.1, -0.25, 0.15]) * (0.9 + 0.1 * k)
        place += np.sin(np.pi * s)[:, None] * np.array([0.02, 0.0, 0.05])
        angle, axis = s * (0.8 + 0.1 * k), np.array([0.6, 0.0, 0.8])
        turn = np.concatenate([np.sin(angle / 2)[:, None] * axis, np.cos(angle / 2)[:, None]], 1)
        x, y, z, w = turn.T
        q = np.stack([w, z, -y, -x], 1)  # (1, 0, 0, 0) times the turn: a hand that looks down
        q = q * np.where(rng.random(len(t)) < 0.3, -1.0, 1.0)[:, None]
        np.savetxt(folder / f"{k}.csv", np.column_stack([t, place, q]), "%.9g", ",", header=HEADER, comments="")
    return [folder / f"{k}.csv" for k in range(3)]


@pytest.mark.slow
def test_own_recordings_become_a_motion_on_an_arm_that_nobody_has_seen(tmp_path):
    columns = ("x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw")
    with pytest.warns(torchds.errors.DemonstrationWarning, match=r"unit quaternion.*poses\.from_poses"):
        raw = torchds.load(recorded(tmp_path), positions=columns)
    place, turned = [d.x[:, :3] for d in raw], [d.x[:, 3:] for d in raw]
    goal = torchds.poses.last_orientation(turned, order="xyzw")
    demos = torchds.poses.from_poses(place, turned, raw.dt, goal, order="xyzw")
    fit = torchds.fit_stable(demos.trim_rests().every(4), n_components=2, n_steps=200)
    assert fit.certificate().stable
    fit.save(tmp_path / "policy.pt", names=demos.names, units="m and rad", dt=0.001)

    lengths = np.random.default_rng(7).uniform([0.33, 0.39, 0.37, 0.1], [0.39, 0.45, 0.43, 0.16])
    d = (lengths[0], 0, lengths[1], 0, lengths[2], 0, lengths[3])
    half = math.pi / 2
    frames = classic((0,) * 7, d, (-half, half, half, -half, -half, half, 0))
    arm = mjcf(frames, (6, 5, 4, 4, 3, 2, 1), (200, 200, 100, 100, 60, 40, 40), 2.9)
    given = {"arm": arm, "goal": goal[[3, 0, 1, 2]].tolist(), "start": demos[1].x[0].tolist(), "posture": POSTURE}
    (tmp_path / "given.json").write_text(json.dumps({**given, "seconds": SECONDS}))
    command = [sys.executable, "-c", ROBOT, str(tmp_path / "given.json"), str(tmp_path / "policy.pt")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert not said["torch"] and not said["cut"] and not said["saturated"] and said["late"] == 0
    assert said["begun"] < 1e-6
    assert said["off"][0] < 0.005 and math.degrees(said["off"][1]) < 1.0
    np.testing.assert_allclose(said["end"], fit.goal, atol=0.01)
    np.testing.assert_allclose(said["tool"], fit.goal[:3], atol=0.01)
