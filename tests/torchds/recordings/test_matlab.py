"""MATLAB files: structs at any depth, and damaged ones."""

import numpy as np
import pytest

from tests.motions import refuses
from tests.recorded import MOTION, SPEED, STEP, cell, is_motion
from torchds import load
from torchds.errors import FileError, UnknownNameError


@pytest.mark.slow
def test_structs_in_cells_at_any_depth(mat):
    path = mat(
        recorded=cell({"pose": MOTION.T, "dt": STEP, "origin": "arm"}, {"pose": MOTION.T, "dt": STEP, "origin": "arm"})
    )
    with refuses(FileError, "1 x 2 cell, each a struct of pose, dt, origin", "positions='pose'"):
        load(path)
    assert is_motion(load(path, positions="pose"), x=MOTION, dt=STEP, n=2)
    inner = cell(cell({"arm": {"pos": MOTION.T, "vel": SPEED.T}}), cell({"arm": {"pos": MOTION.T, "vel": SPEED.T}}))
    demos = load(mat(recorded=inner, dt=STEP))
    assert is_motion(demos, x=MOTION, dt=STEP, n=2)
    assert np.array_equal(demos[0].v, SPEED)
    with refuses(UnknownNameError, "field in a.mat 'poses'", "Known: arm, dt, pos, recorded, vel"):
        load(mat(recorded=inner, dt=STEP), positions="poses")


@pytest.mark.slow
def test_a_mutated_mat_file_is_an_error_and_not_the_end(mat):
    """scipy crashes on some; its process is another one."""
    path = mat(data=cell(MOTION.T, MOTION.T), dt=STEP)
    content = path.read_bytes()
    for cut in (len(content) // 3, len(content) - 20):
        path.write_bytes(content[:cut])
        with refuses(FileError, "not a readable MATLAB file"):
            load(path)
