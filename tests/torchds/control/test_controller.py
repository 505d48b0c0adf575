"""A policy in the loop: the same motion as a roll-out, within bounds, interrupted, pushed, late, and without torch."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import needs_numba
from tests.without_torch import WITHOUT_TORCH
from torchds import Controller, control
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError

ROOT = Path(__file__).parents[3]
FORMS = [False, pytest.param(True, marks=[needs_numba, pytest.mark.slow])]  # compiling takes seconds
SIZES = [{}, {"O": 3}, {"K": 1, "D": 1, "O": 1}, {"K": 4, "D": 3, "O": 3, "Q": 2}]


@pytest.fixture
def spring():
    """ẋ = −x in the plane, of two components."""
    eye = torch.eye(2, dtype=torch.float64).repeat(2, 1, 1)
    policy = torchds.GMRPolicy(torch.ones(2) / 2, torch.randn(2, 2).double(), eye, -eye, torch.zeros(2, 2))
    policy.info = policy.info._replace(goal=torch.zeros(2).double())
    return policy


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def run(controller, n, **step):
    ticks = [controller.step(**step) for _ in range(n)]
    return np.stack([tick.x for tick in ticks]), np.stack([tick.v for tick in ticks]), ticks


# ---------------------------------------------------------------------- the motion


@pytest.mark.parametrize("compiled", FORMS)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.slow
def test_it_is_the_rollout(random_policy, randn, compiled, size):
    policy = random_policy(**size, moved=True)
    x0 = randn(policy.input_dim)
    path = torchds.rollout(policy, x0, 200, 0.01, backend="eager")
    controller = Controller(policy, 0.01, compiled=compiled)
    for _ in range(2):
        controller.reset(x0)
        x, v, ticks = run(controller, 200)
        close = {"rtol": 1e-12, "atol": 1e-12}
        np.testing.assert_allclose(x, path.x[1:].detach().numpy(), **close)
        np.testing.assert_allclose(v, path.v.detach().numpy(), **close)
        if policy.stiffness_dim:
            np.testing.assert_allclose([tick.stiffness for tick in ticks], path.stiffness.detach().numpy(), **close)
        assert not any(tick.cut for tick in ticks) and all(
            len(tick.stiffness) == policy.stiffness_dim for tick in ticks
        )


@pytest.mark.parametrize("compiled", FORMS)
def test_with_feedback_the_policy_sees_what_was_measured(random_policy, randn, compiled):
    policy = random_policy(Q=1)
    controller = Controller(policy, 0.01, feedback=True, compiled=compiled)
    controller.reset(np.zeros(2))
    for x in randn(20, 2):
        tick, v = controller.step(x.numpy()), policy(x).detach().numpy()
        np.testing.assert_allclose(tick.v, v, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(tick.x, x.numpy() + 0.01 * v, rtol=1e-12, atol=1e-12)


def test_a_policy_in_float32_and_components_without_a_prior_are_taken(random_policy, randn):
    policy = random_policy()
    priors = torch.tensor([0.5, 0.5, 0.0])
    padded = torchds.GMRPolicy(priors, policy.means, policy.covariances, policy.A.detach(), policy.b.detach())
    for given in (policy.float(), padded):
        controller = Controller(given, 0.1)
        controller.reset([0.3, 0.1])
        expected = given(torch.tensor([0.3, 0.1]).to(given.A)).detach().numpy()
        np.testing.assert_allclose(controller.step().v, expected, rtol=1e-5)


# ---------------------------------------------------------------------- bounds


@pytest.mark.parametrize("compiled", FORMS)
@pytest.mark.slow
def test_bounds_hold_and_what_was_cut_is_reported(random_policy, randn, compiled):
    policy, dt = random_policy(K=4, D=3, O=3, Q=2), 0.01
    controller = Controller(
        policy, dt, compiled=compiled, max_speed=0.5, max_acceleration=2.0, workspace=(-0.2, [0.2, 0.3, 0.2])
    )
    low, high, seen = np.full(3, -0.2), np.array([0.2, 0.3, 0.2]), set()
    for x0 in np.linspace(-0.2, 0.2, 20)[:, None] * np.ones(3):
        controller.reset(x0)
        before, x = np.zeros(3), x0
        for _ in range(60):
            tick = controller.step()
            seen.update(tick.reasons)
            assert np.linalg.norm(tick.v) <= 0.5 * (1 + 1e-12)
            assert (low <= tick.x).all() and (tick.x <= high).all()
            np.testing.assert_allclose(tick.x, x + dt * tick.v, rtol=0, atol=1e-15)
            if not tick.cut & control.Cut.WORKSPACE:
                assert np.linalg.norm(tick.v - before) <= 2.0 * dt * (1 + 1e-9)
            before, x = tick.v.copy(), tick.x
    assert seen == {"speed", "acceleration", "workspace"}


@needs_numba
@pytest.mark.slow
def test_the_compiled_tick_is_the_plain_one(random_policy):
    policy = random_policy(K=4, D=3, O=4, Q=2)
    options = {"max_speed": 0.5, "max_acceleration": 3.0, "workspace": (-0.2, 0.2)}
    both = [Controller(policy, 0.01, compiled=compiled, **options) for compiled in (False, True)]
    for controller in both:
        controller.reset(np.full(3, 0.1))
        controller.shift[:] = 0.05
    for i in range(300):
        if i == 150:
            [controller.pause() for controller in both]
        a, b = (controller.step() for controller in both)
        np.testing.assert_allclose(a._row, b._row, rtol=1e-11, atol=1e-12)
        assert a.cut == b.cut


# ---------------------------------------------------------------------- while it runs


@pytest.mark.parametrize("compiled", FORMS)
def test_a_pause_comes_to_rest_on_the_path_in_time_and_goes_on(spring, compiled):
    controller = Controller(spring, 1e-3, compiled=compiled, braking=0.1)
    controller.reset([1.0, 2.0])
    run(controller, 50)
    controller.pause()
    x, v, _ = run(controller, 101)
    assert controller.resting and not v[-1].any() and not v[-2].any() and v[-5].any()
    run(controller, 30)
    controller.resume()
    assert not controller.resting
    y, w, _ = run(controller, 400)
    line = np.concatenate([x, y])
    np.testing.assert_allclose(line[:, 1], 2 * line[:, 0], rtol=1e-12)  # the motion is a straight line to the origin
    np.testing.assert_allclose(w[-1], -y[-2], rtol=1e-12)  # as fast as before
    steps = np.linalg.norm(np.diff(np.concatenate([v, w]), axis=0), axis=1)
    assert steps.max() < 1.5 * math.hypot(1, 2) * 1e-3 / 0.1 + 1e-2  # no jump


def test_a_stop_is_for_good_until_reset(spring):
    controller = Controller(spring, 1e-3, braking=0.05)
    controller.reset([1.0, 2.0])
    run(controller, 5)
    controller.stop()
    run(controller, 60)
    assert controller.resting
    with pytest.raises(InvalidArgumentError, match="stopped has to begin anew"):
        controller.resume()
    controller.reset([1.0, 1.0])
    assert not controller.resting and controller.step().v.any()


def test_a_new_target_while_it_runs_is_a_shifted_field(random_policy, randn):
    policy, x0, goal, target = random_policy(), randn(2), randn(2), randn(2)
    controller = Controller(policy, 0.01)
    with pytest.raises(InvalidArgumentError, match="where the motion ends is not known; give goal="):
        controller.retarget(target)
    controller.reset(x0)
    first, _, _ = run(controller, 20)
    controller.retarget(target, goal=goal)
    second, _, _ = run(controller, 20)
    path = (
        torchds.rollout(policy, x0, 40, 0.01, shift=lambda t: (target - goal) * (t > 0.195), backend="eager")
        .x[1:]
        .detach()
    )
    np.testing.assert_allclose(np.concatenate([first, second]), path, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_a_new_target_is_reached_from_the_goal_of_the_policy(spring):
    controller = Controller(spring, 0.01)
    controller.reset([1.0, 2.0])
    controller.retarget([3.0, -1.0])
    x, _, _ = run(controller, 2000)
    np.testing.assert_allclose(x[-1], [3.0, -1.0], atol=1e-6)


@pytest.mark.parametrize("x", [None, [math.nan, 0.0], [math.inf, 0.0], [1.0], "no"])
def test_a_measurement_that_is_none_is_refused_and_the_next_one_goes_on(spring, x):
    controller = Controller(spring, 0.1, feedback=True)
    controller.reset([1.0, 2.0])
    with pytest.raises(InvalidArgumentError, match="needs the measured position of 2 finite numbers, got"):
        controller.step(x if x is None or isinstance(x, str) else np.array(x))
    assert controller.step(np.array([1.0, 2.0])).v.tolist() == [-1.0, -2.0]


def test_a_velocity_that_is_not_finite_is_never_given(spring):
    controller = Controller(spring, 0.1, feedback=True)
    controller.reset([1.0, 2.0])
    with np.errstate(all="ignore"), pytest.raises(InvalidArgumentError, match="the velocity has to be finite"):
        controller.step(np.array([1e200, 0.0]))
    assert controller.step(np.array([1.0, 2.0])).v.tolist() == [-1.0, -2.0]


def test_ticks_that_come_late_say_so(spring):
    clock = Clock()
    controller = Controller(spring, 0.01, clock=clock)
    controller.reset([1.0, 2.0])
    late = []
    for wait in (5.0, 0.01, 0.012, 0.030, 0.01, 0.002):  # the first has no one before it
        clock.now += wait
        late.append(controller.step().late)
    assert late == [0, 0, 0, pytest.approx(0.02), 0, 0] and controller.late == 1


# ---------------------------------------------------------------------- what a loop needs


@pytest.mark.slow
def test_nothing_is_allocated_between_two_ticks(spring):
    controller = Controller(spring, 1e-3, history=50, max_speed=1.0, max_acceleration=3.0, workspace=(-5, 5))
    controller.reset([1.0, 2.0])
    _, _, ticks = run(controller, 50)
    ours = [tick.x.__array_interface__["data"] for tick in ticks]
    run(controller, 100)
    blocks = sys.getallocatedblocks()
    for _ in range(2000):
        controller.step()
    assert sys.getallocatedblocks() - blocks < 50
    _, _, again = run(controller, 50)
    assert {id(tick) for tick in again} == {id(tick) for tick in ticks}
    assert sorted(ours) == sorted(tick.x.__array_interface__["data"] for tick in again)


def test_what_a_tick_shows_cannot_be_spoiled(spring):
    controller = Controller(spring, 0.1)
    controller.reset([1.0, 2.0])
    tick = controller.step()
    for shown in (tick.x, tick.v, tick.stiffness):
        with pytest.raises(ValueError, match="read-only"):
            shown[...] = 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dt": 0.0}, "dt has to be positive, got 0.0"),
        ({"dt": math.inf}, "dt has to be positive"),
        ({"max_speed": -1.0}, "max_speed has to be positive"),
        ({"max_acceleration": math.nan}, "max_acceleration has to be positive"),
        ({"braking": 0.0}, "braking has to be positive"),
        ({"history": 1}, "history has to be at least 2 ticks"),
        ({"workspace": (1.0, -1.0)}, r"workspace has to be \(low, high\) with low < high"),
        ({"policy": torch.nn.Linear(2, 2)}, r"policy has to be a GMRPolicy, got Linear; load\(\) takes a file"),
    ],
)
def test_what_cannot_be_is_refused(spring, options, words):
    with pytest.raises(InvalidArgumentError, match=words):
        Controller(**{"policy": spring, "dt": 0.1, **options})


def test_starts_batches_and_steps_before_the_reset_are_refused(spring):
    with pytest.raises(InvalidArgumentError, match=r"a batch of \(3,\); give one of them, policy\[i\]"):
        Controller(spring.expand(3), 0.1)
    controller = Controller(spring, 0.1, workspace=(-1, 1))
    with pytest.raises(InvalidArgumentError, match=r"call reset\(x0\)"):
        controller.step()
    for x0, words in (([0.0], "x0 has to be 2 finite numbers"), ([2.0, 0.0], "x0 has to be in the workspace")):
        with pytest.raises(InvalidArgumentError, match=words):
            controller.reset(x0)


def test_without_numba_the_extra_is_named(spring, monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "torchds.control.compiled", raising=False)
    monkeypatch.delattr(control, "compiled", raising=False)
    with pytest.raises(MissingPackageError, match=r"pip install 'torchds\[fast\]'"):
        Controller(spring, 0.1, compiled=True)


# ---------------------------------------------------------------------- without torch

ROBOT = (
    WITHOUT_TORCH
    + """import torchds
controller = torchds.Controller.load(sys.argv[1], max_speed=100.0)
controller.reset([0.3, -0.2])
ticks = [controller.step() for _ in range(100)]
try:
    torchds.rollout
except AttributeError as error:
    said = str(error)
x, stiffness = [t.x.tolist() for t in ticks], [t.stiffness.tolist() for t in ticks]
print(json.dumps([x, stiffness, list(controller.goal), said, "torch" in sys.modules]))
"""
)


@pytest.mark.slow
def test_the_computer_of_a_robot_needs_no_torch(random_policy, tmp_path):
    policy = random_policy(Q=1, moved=True)
    policy.save(tmp_path / "policy.pt", goal=[1.0, 2.0], dt=0.01)
    command = [sys.executable, "-c", ROBOT, str(tmp_path / "policy.pt")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    x, stiffness, goal, said, loaded = json.loads(done.stdout)
    path = torchds.rollout(policy, [0.3, -0.2], 100, 0.01, backend="eager")
    np.testing.assert_allclose(x, path.x[1:].detach(), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(stiffness, path.stiffness.detach(), rtol=1e-12, atol=1e-12)
    assert goal == [1.0, 2.0] and said.startswith("torchds.rollout needs torch, which is not installed") and not loaded


def test_a_file_without_a_time_step_asks_for_one(random_policy, tmp_path):
    random_policy().save(tmp_path / "policy.pt")
    with pytest.raises(InvalidArgumentError, match=r"policy.pt does not say a time step; give dt="):
        Controller.load(tmp_path / "policy.pt")
    assert Controller.load(tmp_path / "policy.pt", 0.1, feedback=True).feedback
    with pytest.raises(FileError, match="no such file"):
        Controller.load(tmp_path / "none.pt")


@pytest.mark.slow
def test_a_recorded_pose_motion_leaves_the_computer(tmp_path):
    """CSV with quaternions, a stable fit, one file, and 10 s at 1 kHz where there is no torch: the goal's pose is reached."""
    t = np.linspace(0, 4, 81)
    s = (1 - t / 4) ** 2
    angle = 2.0 * s  # rad, about an oblique axis, to a goal that is turned itself
    axis, goal = np.array([0.6, 0.0, -0.8]), np.array([0.1, -0.7, 0.5, 0.5])
    q = torchds.poses.quaternion(torch.from_numpy(angle[:, None] * axis), torch.from_numpy(goal), order="xyzw").numpy()
    q[::7] *= -1  # the same orientations
    table = np.column_stack([t, 0.3 * s, 0.2 * np.sin(2 * s), 0.4 - 0.1 * s, q])
    np.savetxt(tmp_path / "pose.csv", table, delimiter=",", header="time,x,y,z,qx,qy,qz,qw", comments="")
    with pytest.warns(torchds.errors.DemonstrationWarning, match="unit quaternion"):
        raw = torchds.load(tmp_path / "pose.csv", positions=("x", "y", "z", "qx", "qy", "qz", "qw"))
    turned = [d.x[:, 3:] for d in raw]
    star = torchds.poses.last_orientation(turned, order="xyzw")
    demos = torchds.poses.from_poses([d.x[:, :3] for d in raw], turned, raw.dt, star, order="xyzw")
    fit = torchds.fit_stable(demos, n_components=2, n_steps=60)
    fit.save(tmp_path / "policy.pt", names=demos.names, units="m and rad", dt=1e-3)
    x0 = demos[0].x[0].tolist()
    script = ROBOT.split("controller = ")[0] + (
        "controller = torchds.Controller.load(sys.argv[1], max_speed=2.0)\n"
        f"controller.reset({x0})\n"
        "for _ in range(10_000):\n    tick = controller.step()\n"
        "print(json.dumps(tick.x.tolist()))\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "policy.pt")]
    end = torch.tensor(json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout))
    assert float((end - fit.goal).norm()) < 0.01
    reached = torchds.poses.quaternion(end.double(), star, order="xyzw")
    assert 2 * math.acos(min(1.0, abs(float(reached @ star)))) < math.radians(1)
