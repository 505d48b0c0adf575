"""Arrays of which it is not said which axis or column is what."""

import numpy as np
import pytest

from tests.motions import refuses
from tests.recorded import MOTION, SPEED, STEP, cell, is_motion
from torchds import load
from torchds.errors import DemonstrationWarning, FileError


@pytest.mark.slow
def test_cells_of_positions_and_velocities_below_each_other(mat):
    both = np.concatenate([MOTION, SPEED], -1).T
    demos = load(mat(data=cell(both, both), dt=STEP))
    assert is_motion(demos, x=MOTION, dt=STEP, n=2)
    assert np.array_equal(demos[0].v, SPEED)
    # What is no derivative stays a position.
    other = np.concatenate([MOTION, SPEED[::-1]], -1).T
    assert load(mat(data=cell(other), dt=STEP)).dim == 4


@pytest.mark.slow
def test_several_demonstrations_in_one_matrix(mat):
    both = np.concatenate([MOTION, SPEED], -1)
    path = mat(Data=np.concatenate([both, both, both]).T)
    with refuses(FileError, "no time step; pass dt=", "its velocities fit dt=0.0339"):
        load(path)
    with pytest.warns(DemonstrationWarning, match=r"row 59: a jump .*\[jump\]. Call split\(\)"):
        assert len(load(path, dt=STEP)) == 1
    assert is_motion(load(path, dt=STEP, split=True), x=MOTION, dt=STEP, n=3)


@pytest.mark.slow
def test_a_first_column_that_rises_evenly_is_asked_for(mat):
    path = mat(recording=np.column_stack([STEP * np.arange(60), MOTION]))
    with refuses(FileError, "the first of 3 columns rises evenly", "time=0", "positions=(0, 1, 2)"):
        load(path)
    assert is_motion(load(path, time=0), x=MOTION, dt=STEP)
    assert load(path, positions=(0, 1, 2), dt=STEP).dim == 3
    assert load(path, time=0, positions=(1,), velocities=(2,)).dim == 1


def test_transposed_arrays_in_an_archive_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, x0=MOTION.T, dt=STEP)
    with refuses(FileError, "2 samples of 60 dimensions?", "time_axis=1", "time_axis=0"):
        load(path)
    assert is_motion(load(path, time_axis=1), x=MOTION, dt=STEP)
    np.savez(path, x0=MOTION.T, t0=STEP * np.arange(60))  # as many stamps as columns
    assert is_motion(load(path), x=MOTION, dt=STEP)


def test_arrays_of_other_names(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, ee=MOTION, ee_rate=SPEED, clock=1000 * STEP * np.arange(60))
    with refuses(FileError, "no positions", "positions=", "the file has ee, ee_rate, clock"):
        load(path)
    demos = load(path, positions="ee", velocities="ee_rate", time="clock", time_unit="ms")
    assert is_motion(demos, x=MOTION, dt=STEP)
    assert np.array_equal(demos[0].v, SPEED)
