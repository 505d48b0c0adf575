"""What a session is told is questioned, what it gave out is not replaced, and files from elsewhere are suspected."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

from tests.faults.cases import fuzz
from torchds import files
from torchds.errors import FileError, InvalidArgumentError
from torchds.locks import one_writer
from torchds.sessions import tables
from train.hardware import robot_files
from train.hardware.command import SessionOptions
from train.hardware.questions import question
from train.hardware.robot_files import Recorded
from train.hardware.session import Session

from hypothesis import strategies as st  # isort: skip

T, DT, N = 500, 0.02, 3
HEADER = "time [s],x [m],z [m],angle [rad],force_x [N],force_z [N]"


def asked():
    """Three references `(N, T+1, 3)` that differ by some centimetres, and their stiffness `(N, T)`."""
    t = torch.linspace(0, 1, T + 1, dtype=torch.float64)
    motions = []
    for k in range(N):
        x = 0.59 + 0.25 * torch.sin(2.5 * t) + 0.04 * k * torch.sin(6 * t)
        z = 0.24 - 0.2 * torch.sin(3.1 * t) ** 2 + 0.03 * k * (1 - torch.cos(5 * t))
        motions.append(torch.stack([x, z, -0.6 + 1.2 * t**2 + 0.1 * k * t], -1))
    return torch.stack(motions), torch.full((N, T), 250.0, dtype=torch.float64)


def executed(poses, stiffness, seed=0, soft=0.03):
    """What a soft arm makes of them: late, deflected, noisy; and the forces of its springs."""
    rng = np.random.default_rng(seed)
    t = torch.linspace(0, 1, T + 1, dtype=torch.float64)
    bend = soft * torch.sin(np.pi * t)[:, None] * torch.from_numpy(rng.uniform(-1, 1, (N, 1, 3)))
    late = torch.cat([poses[:, :1].expand(-1, 5, -1), poses[:, :-5]], 1)
    pose = late + bend + torch.from_numpy(rng.normal(0, 2e-4, poses.shape))
    pose[:, 0] = poses[:, 0]
    spring = stiffness[..., None] * (poses - pose)[:, 1:, :2]
    force = torch.stack([spring[..., 0], torch.zeros_like(spring[..., 0]), spring[..., 1]], -1)
    return Recorded(pose, force + torch.from_numpy(rng.normal(0, 0.3, force.shape)))


def names(recorded, poses, stiffness):
    return {(finding.name, finding.rollouts) for finding in question([1, 2, 3], recorded, poses, stiffness, DT)}


@fuzz(usual=25, seed=st.integers(0, 2**31), soft=st.floats(0, 0.07))  # references differ by 0.076 on average
@pytest.mark.slow
def test_what_a_soft_arm_does_is_believed(seed, soft):
    poses, stiffness = asked()
    assert names(executed(poses, stiffness, seed, soft), poses, stiffness) == set()


@pytest.mark.parametrize("seed", [4360797, 38844])
def test_a_soft_arm_that_looks_turned_by_21_degrees_or_exchanged_is_believed(seed):
    poses, stiffness = asked()
    assert names(executed(poses, stiffness, seed, 0.078125), poses, stiffness) == set()


def still(pose, force):
    pose[1] = pose[1, :1]


def half_speed(pose, force):
    steps = np.arange(pose.shape[1])
    pose[1] = torch.from_numpy(np.column_stack([np.interp(0.5 * steps, steps, c) for c in pose[1].numpy().T]))


def mirrored(pose, force):
    pose[1, :, 0] = 2 * pose[1, 0, 0] - pose[1, :, 0]


def turned(pose, force):
    x, z = (pose[1, :, :2] - pose[1, :1, :2]).clone().unbind(-1)
    pose[1, :, 0], pose[1, :, 1] = pose[1, 0, 0] - z, pose[1, 0, 1] + x


def swapped(pose, force):
    pose[[0, 2]] = pose[[2, 0]]


def copied(pose, force):
    pose[2], force[2] = pose[1], force[1]


def kilonewtons(pose, force):
    force[1] /= 1000


def millinewtons(pose, force):
    force[1] *= 1000


WRONG = {
    still: ("still", (2,)),
    half_speed: ("speed", (2,)),
    mirrored: ("mirrored", (2,)),
    turned: ("turned", (2,)),
    swapped: ("swapped", (1, 3)),
    copied: ("copied", (2, 3)),
    kilonewtons: ("force", (2,)),
    millinewtons: ("force", (2,)),
}


@pytest.mark.parametrize("change", WRONG)
def test_gross_errors_are_named(change):
    poses, stiffness = asked()
    for seed in range(10):
        recorded = executed(poses, stiffness, seed)
        change(*recorded)
        found = question([1, 2, 3], recorded, poses, stiffness, DT)
        assert WRONG[change] in {(finding.name, finding.rollouts) for finding in found if finding.gross}
        assert all("recording-" in str(finding) for finding in found)


def test_a_jump_of_the_clock_is_found_and_a_gap_is_not():
    t = np.arange(400) * 0.01
    pose = np.column_stack([np.sin(t), np.cos(t), t])
    assert robot_files.clock_jump(t, pose) == ""
    assert robot_files.clock_jump(np.delete(t, slice(200, 208)), np.delete(pose, slice(200, 208), 0)) == ""
    late = t + 0.08 * (t > 2)
    assert "the clock jumps by 0.09 s at 2 s" in robot_files.clock_jump(late, pose)


# ------------------------------------------------------------------ a session of files


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session") / "s"
    Session.start(folder, SessionOptions(seconds=1.0, rollouts=N, updates=2)).ask()
    return folder


@pytest.fixture
def folder(begun, tmp_path):
    import shutil

    shutil.copytree(begun, tmp_path / "s")
    return tmp_path / "s"


def record(update, k, of=None):
    """A recording that follows the reference of roll-out `of`."""
    table = np.loadtxt(update / f"rollout-{of or k}.csv", delimiter=",", skiprows=1)
    rows = np.column_stack([table[:, :4], np.zeros((len(table), 2))])
    np.savetxt(update / f"recording-{k}.csv", rows, "%.17g", ",", header=HEADER, comments="")


def told(folder):
    return (folder / "session.pt").read_bytes()


@pytest.mark.slow
def test_swapped_recordings_are_refused_and_taken_if_one_insists(folder):
    update, before = folder / "update-001", told(folder)
    for k, of in ((1, 1), (2, 3), (3, 2)):
        record(update, k, of)
    with pytest.raises(
        FileError, match=r"recording-2 is the motion of rollout-3\.csv.*insist: .* tell .* --force True"
    ):
        Session.open(folder).tell()
    assert told(folder) == before
    said = str(Session.open(folder).tell(force=True))
    assert "note: recording-2.csv and recording-3.csv: in a wrong order" in said


@pytest.mark.parametrize("cut", [1, 2, 5, 20, 100])
@pytest.mark.slow
def test_half_a_recording_is_refused(folder, cut):
    update = folder / "update-001"
    for k in (1, 2, 3):
        record(update, k)
    path, before = update / "recording-2.csv", told(folder)
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(FileError, match=r"recording-2\.csv.*(half-written|values under)"):
        Session.open(folder).tell()
    assert told(folder) == before


@pytest.mark.slow
def test_half_written_costs_are_refused(folder):
    (folder / "update-001" / "costs.csv").write_text("rollout,cost\n1,1.0\n2,3.0\n3,1")
    with pytest.raises(FileError, match=r"costs\.csv: ends within a line"):
        Session.open(folder).tell()


@pytest.mark.slow
def test_a_file_that_grows_is_not_read(folder, monkeypatch):
    path = folder / "update-001" / "costs.csv"
    path.write_text("rollout,cost\n1,1.0\n2,3.0\n3,1.0\n")

    def meanwhile(seconds):
        with path.open("a") as file:
            file.write("4,")

    monkeypatch.setattr(tables.time, "sleep", meanwhile)
    with pytest.raises(FileError, match=r"costs\.csv: somebody is writing it"):
        Session.open(folder).tell()


@pytest.mark.parametrize("raw", [b"\xff\xfe\x00rollout", b"rollout,cost\n1,\xe9\n", b"\x00" * 50 + b"\n"])
@pytest.mark.slow
def test_costs_in_an_unreadable_encoding_are_refused(folder, raw):
    (folder / "update-001" / "costs.csv").write_bytes(raw)
    with pytest.raises(FileError, match=r"costs\.csv"):
        Session.open(folder).tell()


@pytest.mark.slow
def test_a_stale_process_replaces_nothing(folder):
    stale, update = Session.open(folder), folder / "update-001"
    (update / "costs.csv").write_text("rollout,cost\n1,1.0\n2,3.0\n3,1.0\n")
    Session.open(folder).tell()
    Session.open(folder).ask()
    before = {path: path.read_bytes() for path in folder.rglob("[!.]*") if path.is_file()}
    for command in (stale.ask, stale.tell):
        with pytest.raises(
            FileError, match="another process has gone on with the session since it was opened; open it ag"
        ):
            command()
    assert {path: path.read_bytes() for path in folder.rglob("[!.]*") if path.is_file()} == before


def test_the_second_process_is_told_who_works_there(folder):
    with one_writer(folder), pytest.raises(FileError, match=r"is in use by process \d+"):
        Session.open(folder).tell()


@pytest.mark.slow
def test_references_that_were_changed_are_neither_replaced_nor_believed(folder):
    path = folder / "update-001" / "rollout-2.csv"
    path.write_text(path.read_text().replace("0.", "1.", 1))
    changed = path.read_text()
    with pytest.raises(FileError, match=r"rollout-2\.csv was changed since it was given out"):
        Session.open(folder).tell()
    with pytest.raises(FileError, match=r"rollout-2\.csv was changed since it was given out"):
        Session.open(folder).ask()
    assert path.read_text() == changed


@pytest.mark.slow
def test_references_of_another_session_are_refused(folder):
    path = folder / "update-001" / "asked.json"
    content = files.read_sealed(path)
    files.write_sealed(path, {**content, "id": "another"})
    with pytest.raises(FileError, match="references that this session did not give out"):
        Session.open(folder).ask()


@pytest.mark.parametrize("kind", ["file link", "folder link", "recording"])
@pytest.mark.slow
def test_names_that_are_taken_are_not_written_through(tmp_path, kind):
    mine = Session.start(tmp_path / "s", SessionOptions(seconds=1.0, rollouts=2, updates=1))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    update = tmp_path / "s" / "update-001"
    if kind == "folder link":
        update.symlink_to(elsewhere)
    else:
        update.mkdir()
        if kind == "recording":
            (update / "recording-1.csv").write_text("of last week\n")
        else:
            (update / "rollout-1.csv").symlink_to(elsewhere / "precious")
    with pytest.raises(FileError, match=r"is a link|before anything was asked"):
        mine.ask()
    assert os.listdir(elsewhere) == []


def test_a_folder_of_a_run_takes_no_session(tmp_path):
    (tmp_path / "options.json").write_text("{}")
    with pytest.raises(InvalidArgumentError, match="holds a run; give another folder"):
        Session.start(tmp_path, SessionOptions())


@pytest.mark.parametrize("name", ["demonstrations.npz", "mixture.npz"])
def test_what_a_session_began_with_is_verified(folder, name):
    raw = bytearray((folder / name).read_bytes())
    raw[len(raw) // 2] ^= 1
    (folder / name).write_bytes(raw)
    with pytest.raises(FileError, match=f"{Path(name).stem}.*is damaged, or not the one that the session began with"):
        Session.open(folder)
