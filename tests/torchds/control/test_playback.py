"""The robot's side of a session: what it follows, and recordings that a session takes back."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import torchds
from tests.torchds.sessions.motions import session
from tests.without_torch import WITHOUT_TORCH
from torchds.control import Controller, Playback, Recorder
from torchds.errors import FileError, InvalidArgumentError
from torchds.sessions import Layout
from torchds.sessions.tables import reference_text

ROOT = Path(__file__).parents[3]
ROBOT = (
    WITHOUT_TORCH
    + """from torchds.control import Playback
for path in sys.argv[1:]:
    played = Playback(path)
    x, late = played.x0.copy(), 0.2
    while not played.done:
        tick = played.step(x)
        x += late * (tick.x - x) + tick.v * played.dt  # a robot that lags behind
    played.write()
print(json.dumps("torch" in sys.modules))
"""
)


@pytest.mark.slow
def test_a_session_learns_from_what_a_robot_without_torch_recorded(tmp_path):
    mine = session(tmp_path / "s", "poses")
    paths = sorted(mine.ask().folder.glob("rollout-*.csv"))
    command = [sys.executable, "-c", ROBOT, *map(str, paths)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not json.loads(done.stdout)
    told = mine.tell()
    assert told.failed == 0 and told.notes == [] and all(row[1] > 0 for row in told.rows)


@pytest.mark.slow
def test_a_session_takes_back_what_the_controller_of_its_best_policy_recorded(tmp_path):
    """Roll-out 1 is the policy itself, so that its controller makes the same motion."""
    mine = session(tmp_path / "s", "poses")
    mine.ask()
    (mine.update_folder / "costs.csv").write_text("rollout,cost\n1,1\n2,failed\n3,failed\n")
    mine.tell()  # the policy stays
    mine.export(tmp_path / "best.pt")
    other = session(tmp_path / "t", "poses")
    other.ask()
    controller = Controller.load(tmp_path / "best.pt")
    x0, layout = other.trial.x0.numpy(), other.trial.layout
    recorder = Recorder(layout.position)
    controller.reset(x0)
    recorder.add(0.0, x0)
    for i in range(other.trial.n_steps):
        recorder.add((i + 1) * controller.dt, controller.step().x)
    recorder.write(other.update_folder / "recording-1.csv")
    told = other.tell(missing="failed")
    assert told.failed == 2
    with torch.no_grad():
        expected = other.trial.cost_terms(torchds.rollout(other.policy, other.trial.x0, 40, 0.05))
    assert told.rows[0][1] == pytest.approx(float(expected["goal"]), rel=1e-9)


def reference(
    folder, text="time [s],x [m],v_x [m/s],s [N/m]\n0.0,1.0,2.0,5.0\n0.5,2.0,0.0,5.0\n", name="rollout-2.csv"
):
    (folder / name).write_text(text)
    return folder / name


def test_each_tick_is_a_row_and_the_recording_stands_beside(tmp_path):
    played = Playback(reference(tmp_path), measured=("f [N]",))
    assert played.dt == 0.5 and played.position == ("x [m]",) and played.x0.tolist() == [1.0]
    tick = played.step([1.25], 7.0)
    assert (tick.x.tolist(), tick.v.tolist(), tick.stiffness.tolist()) == ([1.0], [2.0], [5.0])
    assert not tick.x.flags.writeable
    played.step([2.25], [8.0])
    assert played.done
    with pytest.raises(InvalidArgumentError, match=r"has ended; write\(\) its recording"):
        played.step([0.0], 0.0)
    path = played.write()
    assert path.name == "recording-2.csv"
    assert path.read_text() == "time [s],x [m],f [N]\n0.0,1.25,7.0\n0.5,2.25,8.0\n"


def test_a_motion_that_was_stopped_is_a_failure(tmp_path):
    played = Playback(reference(tmp_path))
    played.step([1.0])
    assert played.write().name == "recording-2.failed"


def test_a_motion_that_is_repeated_to_its_end_takes_back_its_own_mark(tmp_path):
    for steps, mark in ((1, True), (2, False), (1, True), (2, False)):
        played = Playback(reference(tmp_path))
        for _ in range(steps):
            played.step([1.0])
        played.write()
        assert (tmp_path / "recording-2.failed").exists() == mark
    (tmp_path / "recording-2.failed").touch()  # of whoever watched
    played.write()
    assert (tmp_path / "recording-2.failed").exists()


def test_velocities_are_those_of_the_layout(tmp_path):
    layout = Layout(("v_x [m]", "y [m]"), velocity=("dx [m/s]", "dy [m/s]"), stiffness=("s [N/m]",))
    x = torch.arange(8.0).reshape(4, 2)
    path = reference(tmp_path, reference_text(layout, x, x.diff(dim=0), torch.ones(3, 1), 0.5))
    with pytest.raises(
        FileError, match=r"velocities are not the columns v_x \[m\]; give those of the layout, velocity="
    ):
        Playback(path)
    played = Playback(path, velocity=layout.velocity)
    tick = played.step([0.0, 0.0])
    assert played.position == layout.position
    assert (tick.x.tolist(), tick.v.tolist(), tick.stiffness.tolist()) == ([0.0, 1.0], [2.0, 2.0], [1.0])


def test_wrong_numbers_and_files_are_refused(tmp_path):
    played = Playback(reference(tmp_path))
    for values in (([1.0, 2.0],), (), ([1.0], 2.0), ([[1.0]],)):
        with pytest.raises(InvalidArgumentError, match=r"one number for each of x \[m\]"):
            played.step(*values) if values else played.recorder.add(0.0)
    for text in (
        "",
        "time [s],x [m]\n0,1\n",
        "time [s],x [m],v_x [m/s]\n0,1,a\n1,1,1\n",
        "time [s],x [m],v_x [m/s]\n0,1,1\n",
    ):
        with pytest.raises(FileError, match="is no reference of a session"):
            Playback(reference(tmp_path, text))
    with pytest.raises(FileError, match="is no reference of a session"):
        Playback(reference(tmp_path, name="other.csv"))
    with pytest.raises(FileError, match="no such file"):
        Playback(tmp_path / "rollout-9.csv")
    recorder = Recorder(("x [m]",), n=1)
    recorder.add(0.0, np.ones(1))
    with pytest.raises(InvalidArgumentError, match="room for 1 rows; make the recorder with a larger n="):
        recorder.add(1.0, 1.0)
    with pytest.raises(FileError, match="cannot be written"):
        recorder.write(tmp_path / "none" / "recording-1.csv")
