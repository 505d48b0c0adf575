"""Several demonstrations in one file, and padding."""

import numpy as np
import pytest
import scipy.io
import torch

from tests.motions import refuses
from tests.recorded import COUNT, DT, MOTION, STEP, TIMES, X, is_motion, table, whole
from torchds import load
from torchds.errors import DemonstrationWarning, FileError, InvalidArgumentError


def test_time_that_starts_anew(file):
    path = file(table("time,x,y", np.tile(TIMES[:10], 2), *X.T))
    with pytest.warns(DemonstrationWarning, match=r"2 demonstrations, since time starts anew at rows \[10\]"):
        demos = load(path)
    assert is_motion(demos, x=X[:10], n=2)
    assert torch.allclose(demos[1].x, torch.from_numpy(X[10:]), atol=1e-6)
    with refuses(FileError, "row 9 to row 10", "time goes from 0.09 to 0.0 s", "the time goes back"):
        load(path, split=False)


@pytest.mark.parametrize("name", ["demo", "trial", "episode_id", "demonstration", "traj"])
def test_a_column_that_numbers_the_demonstrations(file, name):
    path = file(table(f"{name},x,y", whole(COUNT // 10), *X.T))
    with refuses(FileError, "no time step; pass dt="):
        load(path)
    assert is_motion(load(path, dt=DT), x=X[:10], n=2)


def test_a_column_of_words_that_tells_demonstrations_apart(file):
    path = file(table("part,time,x,y", ["a"] * 10 + ["b"] * 10, np.tile(TIMES[:10], 2), *X.T))
    assert is_motion(load(path, split="part"), x=X[:10], n=2)


def test_blank_lines(file):
    lines = table("x,y", *X.T).splitlines()
    path = file("\n".join([*lines[:11], "", "", *lines[11:]]))
    with pytest.warns(DemonstrationWarning, match="2 demonstrations, since blank lines stand"):
        assert is_motion(load(path, dt=DT), x=X[:10], n=2)
    assert is_motion(load(path, dt=DT, split=False))


@pytest.mark.slow
def test_folders_and_patterns(tmp_path):
    for i in range(3):
        scipy.io.savemat(tmp_path / f"run{i}.mat", {"x": X + i, "dt": DT})
    (tmp_path / "notes.md").write_text("-")
    assert is_motion(load(tmp_path), n=3)
    assert is_motion(load(tmp_path / "run[02].mat"), n=2)
    assert is_motion(load([tmp_path / "run0.mat"]))
    with refuses(FileError, "*.npz: no file matches"):
        load(tmp_path / "*.npz")
    np.savez(tmp_path / "b.npz", x=X, dt=DT)
    with refuses(FileError, "files of several kinds, .mat, .npz", "*.mat"):
        load(tmp_path)


def test_dt_of_several_files_of_which_some_have_a_clock(tmp_path):
    def write(i, **clock):
        np.savez(tmp_path / f"run{i}.npz", x=X + i, **clock)

    write(0)
    write(1, dt=0.02)
    pattern = tmp_path / "*.npz"
    with refuses(FileError, "run0", "no time step; pass dt="):
        load(pattern)
    with refuses(
        FileError, "run1", "dt says 0.02 s but the argument dt 0.01 s", "one for each, None where it has a clock"
    ):
        load(pattern, dt=0.01)
    for steps in ([0.01, None], (0.01, 0.02), np.array([0.01, 0.02])):
        demos = load(pattern, dt=steps)
        assert demos.dt == (0.01, 0.02) and torch.equal(demos[1].x, torch.from_numpy(X + 1))
    with refuses(FileError, "run1", "dt says 0.02 s but the argument dt 0.03 s"):
        load(pattern, dt=[0.01, 0.03])
    with refuses(InvalidArgumentError, "dt has to be one value for all or one for each of the 2 demonstrations, got 3"):
        load(pattern, dt=[0.01, None, 0.02])
    write(1)
    assert load(pattern, dt=0.01).dt == (0.01, 0.01) and load(pattern, dt=[0.01, 0.02]).dt == (0.01, 0.02)


@pytest.mark.slow
def test_dt_of_several_matlab_files(tmp_path):
    scipy.io.savemat(tmp_path / "run0.mat", {"x": X})
    scipy.io.savemat(tmp_path / "run1.mat", {"x": X, "dt": 0.02})
    assert load(tmp_path, dt=[0.01, None]).dt == (0.01, 0.02)


def test_dt_of_several_tables(tmp_path):
    for i in range(2):
        (tmp_path / f"run{i}.csv").write_text(table("x,y", *(X + i).T))
    assert load(tmp_path, dt=[0.01, 0.02]).dt == (0.01, 0.02)
    with refuses(FileError, "run0", "no time step; pass dt="):
        load(tmp_path, dt=[None, 0.02])


def test_what_is_suspicious_about_several_files_together_is_said_once(tmp_path):
    for i in range(3):
        np.savez(tmp_path / f"run{i}.npz", x=MOTION + 50 * (i == 2), dt=STEP)
    with pytest.warns(DemonstrationWarning, match=r"\[goals apart\]") as said:
        load(tmp_path / "*.npz")
    assert len(said) == 1


@pytest.mark.slow
def test_padding_by_nan_and_by_zeros(mat):
    padded = np.stack([np.concatenate([MOTION[:50], np.full((10, 2), np.nan)]), MOTION])
    assert [len(d.x) for d in load(mat(demos=padded, dt=STEP))] == [50, 60]  # lengths tell which axis is which
    alike = np.concatenate([padded[:1], padded[:1]])
    path = mat(demos=alike, dt=STEP)
    with refuses(FileError, "2 x 60 x 2", "time_axis=1, demo_axis=0 or time_axis=1, demo_axis=2"):
        load(path)
    with pytest.warns(DemonstrationWarning, match="the last 10 of 60 rows hold no positions and are taken as padding"):
        assert is_motion(load(path, time_axis=1, demo_axis=0), x=MOTION[:50], dt=STEP, n=2)
    turned = mat(demos=alike.transpose(2, 1, 0), dt=STEP)
    assert is_motion(load(turned, time_axis=1, demo_axis=2), x=MOTION[:50], dt=STEP, n=2)
    zeros = np.concatenate([MOTION + 5, np.zeros((10, 2))])
    with pytest.warns(DemonstrationWarning, match="the last 10 of 70 rows are zero behind a jump"):
        assert is_motion(load(mat(x=zeros, dt=STEP)), x=MOTION + 5, dt=STEP)


@pytest.mark.slow
def test_a_motion_that_rests_at_zero_is_not_cut(mat):
    ending = np.concatenate([MOTION - MOTION[-1], np.zeros((10, 2))])
    with pytest.warns(DemonstrationWarning, match="rest"):
        assert len(load(mat(x=ending, dt=STEP))[0].x) == 70
