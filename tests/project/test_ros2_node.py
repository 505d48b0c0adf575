"""The example node: ROS is not here, so stand-ins take the place of its messages; the motion is the controller's."""

import runpy
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch

import torchds
from torchds import poses

NODE = Path(__file__).parents[2] / "docs" / "ros2_node.py"


class Anything:
    """An object with whatever attributes are asked for."""

    def __getattr__(self, name):
        value = Anything()
        setattr(self, name, value)
        return value


class Node:
    given = {}  # noqa: RUF012

    def __init__(self, name):
        self.parameters, self.sent, self.time = {}, {}, 0

    def declare_parameter(self, name, value):
        self.parameters[name] = self.given.get(name, value)

    def get_parameter(self, name):
        return types.SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, kind, topic, depth):
        return types.SimpleNamespace(publish=self.sent.setdefault(topic, []).append)

    def create_subscription(self, *options):
        pass

    create_service = create_timer = create_subscription

    def get_logger(self):
        return types.SimpleNamespace(warning=self.sent.setdefault("log", []).append)

    def get_clock(self):
        stamp = types.SimpleNamespace(nanoseconds=self.time, to_msg=lambda: None)
        return types.SimpleNamespace(now=lambda: stamp)


@pytest.fixture
def node(monkeypatch):
    for name in ("rclpy", "rclpy.node", "geometry_msgs", "geometry_msgs.msg", "std_srvs", "std_srvs.srv"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    sys.modules["rclpy.node"].Node = Node
    for name in ("PoseStamped", "TwistStamped"):
        setattr(sys.modules["geometry_msgs.msg"], name, Anything)
    for name in ("SetBool", "Trigger"):
        setattr(sys.modules["std_srvs.srv"], name, Anything)
    return runpy.run_path(str(NODE), run_name="node")


def test_its_quaternions_are_those_of_the_library(node, randn):
    goal = torch.nn.functional.normalize(randn(4), dim=0)
    for r in 0.9 * randn(20, 3):
        expected = poses.quaternion(r, goal)
        np.testing.assert_allclose(node["quaternion"](r.numpy(), goal.numpy()), expected, atol=1e-14)
        for sign in (1, -1):
            found = node["rotation_vector"](sign * expected.numpy(), goal.numpy())
            np.testing.assert_allclose(found, poses.rotation_vector(expected, goal), atol=1e-12)


@pytest.mark.parametrize("feedback", [False, True])
def test_it_publishes_the_motion_and_records_it(node, tmp_path, monkeypatch, feedback):
    eye = torch.eye(6, dtype=torch.float64)[None]
    policy = torchds.GMRPolicy(
        torch.ones(1), torch.zeros(1, 6), eye, -0.02 * eye, torch.zeros(1, 6)
    )  # slow: nothing is cut
    policy.save(tmp_path / "policy.pt", dt=0.01)
    goal = torch.nn.functional.normalize(torch.tensor([0.5, 0.5, -0.2, 0.3], dtype=torch.float64), dim=0)
    given = {
        "policy": tmp_path / "policy.pt",
        "goal": goal.tolist(),
        "feedback": feedback,
        "recording": tmp_path / "r.csv",
    }
    monkeypatch.setattr(Node, "given", given)
    made, x0 = node["Motion"](), torch.tensor([0.1, 0.2, -0.1, 0.4, -0.3, 0.2], dtype=torch.float64)
    made.tick()
    answer = Anything()
    made.start(None, answer)
    assert made.sent["~/reference"] == [] and not answer.success
    pose = Anything()
    q = poses.quaternion(x0, goal)
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = x0[:3].tolist()
    pose.pose.orientation.w, pose.pose.orientation.x, pose.pose.orientation.y, pose.pose.orientation.z = q.tolist()
    made.look(pose)
    made.start(None, answer)
    for i in range(20):
        made.time = int(1e7 * i)
        made.tick()
    seen = x0 if feedback else torchds.rollout(policy, x0, 20, 0.01).x[-2]
    v = policy(seen).detach()
    last = made.sent["~/reference"][-1].pose
    expected = (seen + 0.01 * v).detach()
    assert (last.position.x, last.position.y, last.position.z) == pytest.approx(expected[:3].tolist(), abs=1e-9)
    o = last.orientation
    assert (o.w, o.x, o.y, o.z) == pytest.approx(poses.quaternion(expected, goal).tolist(), abs=1e-9)
    omega = poses.angular_velocity(expected, v, goal)
    twist = made.sent["~/velocity"][-1].twist
    assert (twist.linear.x, twist.linear.y, twist.linear.z) == pytest.approx(v[:3].tolist(), abs=1e-9)
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == pytest.approx(omega.tolist(), rel=1e-2, abs=1e-5)
    made.pause(types.SimpleNamespace(data=True), answer)
    made.stop(None, answer)
    lines = (tmp_path / "r.csv").read_text().splitlines()
    assert lines[0] == "time [s],x [m],y [m],z [m],rx [rad],ry [rad],rz [rad]" and len(lines) == 21


@pytest.fixture
def motion(node, tmp_path, monkeypatch):
    """A node with a motion along x at about 0.1 m/s, and with a pose; the recording has room for five rows."""

    def make(recording=""):
        eye = torch.eye(6, dtype=torch.float64)[None]
        forward = torch.tensor([[0.1, 0, 0, 0, 0, 0]], dtype=torch.float64)
        torchds.GMRPolicy(torch.ones(1), torch.zeros(1, 6), eye, 0 * eye, forward).save(tmp_path / "policy.pt", dt=0.01)
        monkeypatch.setattr(Node, "given", {"policy": tmp_path / "policy.pt", "recording": recording})
        made = node["Motion"]()
        made.recorder.rows = made.recorder.rows[:5]
        made.measured = np.zeros(6)
        return made

    return make


def asked(service, **request):
    answer = Anything()
    service(types.SimpleNamespace(**request), answer)
    return answer


def test_what_was_stopped_begins_again_once_it_rests(motion):
    made = motion()
    assert asked(made.start).success
    for _ in range(10):
        made.tick()
    assert asked(made.stop).success and not asked(made.start).success  # it still slows down
    refused = asked(made.pause, data=False)
    assert not refused.success and "was stopped has to begin anew" in refused.message
    for _ in range(200):
        made.tick()
    sent = len(made.sent["~/reference"])
    made.tick()
    assert len(made.sent["~/reference"]) == sent < 210 and asked(made.start).success
    made.tick()
    assert len(made.sent["~/reference"]) == sent + 1 and asked(made.pause, data=True).success


def test_it_outlasts_its_recording_and_says_so_once(motion, tmp_path):
    made = motion(tmp_path / "r.csv")
    asked(made.start)
    for _ in range(20):
        made.tick()
    full = [text for text in made.sent["log"] if "the recording is full" in text]
    assert len(made.sent["~/reference"]) == 20 and len(full) == 1
    made.parameters["recording"] = tmp_path / "nowhere" / "r.csv"
    refused = asked(made.stop)
    assert not refused.success and "nowhere" in refused.message


@pytest.mark.parametrize(("recording", "pauses"), [(True, False), (True, True), (False, False)])
def test_only_what_moves_and_is_wanted_is_recorded(motion, tmp_path, recording, pauses):
    made = motion(tmp_path / "r.csv" if recording else "")
    asked(made.start)
    made.tick()
    if pauses:
        asked(made.pause, data=True)
        made.recorder.rows = np.empty((1000, 7))
        for _ in range(100):
            made.tick()
        rest = made.recorder.length
    made.tick()
    assert made.recorder.length == (rest if pauses else 2 * recording)
