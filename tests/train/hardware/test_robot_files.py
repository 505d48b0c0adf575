"""Files between a session and a robot: read back bit for bit, resampled, and refused."""

import math
import re

import numpy as np
import pytest
import torch

from torchds.errors import TorchdsError
from train.hardware import robot_files

T, DT = 50, 0.004
HEADER = "time [s],x [m],z [m],angle [rad],force_x [N],force_z [N]"


def write(path, t, pose, force):
    np.savetxt(path, np.column_stack([t, pose, force]), "%.17g", ",", header=HEADER, comments="")


def test_a_reference_is_read_back_bit_for_bit(tmp_path, randn):
    pose, v, stiffness = randn(T + 1, 3), randn(T, 3), randn(T).abs()
    robot_files.reference(tmp_path, 2).write_text(robot_files.reference_text(pose, v, stiffness, DT))
    table = torch.from_numpy(np.loadtxt(tmp_path / "rollout-2.csv", delimiter=",", skiprows=1))
    assert torch.equal(table[:, 1:4], pose)
    assert torch.equal(table[:-1, 4:7], v) and (table[-1, 4:7] == 0).all()
    assert torch.equal(table[:-1, 7], stiffness) and table[-1, 7] == stiffness[-1]
    assert table[:, 0].tolist() == [round(DT * i, 9) for i in range(T + 1)]


def test_a_recording_at_the_control_steps_is_taken_as_it_is(tmp_path, randn):
    pose, force = randn(T + 1, 3), randn(T + 1, 2)
    write(robot_files.recording(tmp_path, 1), robot_files.control_times(T, DT), pose, force)
    found = robot_files.read_recording(tmp_path / "recording-1.csv", pose[0], T, DT)
    assert torch.equal(found.pose, pose)
    assert torch.equal(found.force[:, [0, 2]], force[1:]) and (found.force[:, 1] == 0).all()


def test_cubic_motions_and_linear_forces_are_resampled_exactly(tmp_path):
    t, times = np.linspace(0, T * DT, 31), robot_files.control_times(T, DT)

    def pose(t):
        return np.stack([t**3 - t, 2 * t**2, 1 - t], -1)

    write(tmp_path / "recording-1.csv", t, pose(t), np.stack([3 * t, -t], -1))
    found = robot_files.read_recording(tmp_path / "recording-1.csv", torch.from_numpy(pose(0.0)), T, DT)
    np.testing.assert_allclose(found.pose, pose(times), rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.force[:, [0, 2]], np.stack([3 * times, -times], -1)[1:], rtol=0, atol=1e-13)


def test_recordings_of_an_update_are_stacked_and_the_robot_stands_still_in_those_that_failed(tmp_path, randn):
    start, times = randn(3), robot_files.control_times(T, DT)
    pose = start + torch.cat([torch.zeros(1, 3), randn(T, 3)])
    write(tmp_path / "recording-2.csv", times, pose, np.ones((T + 1, 2)))
    found = robot_files.read_recordings(tmp_path, ["failed", "there"], start, T, DT)
    assert found.pose.shape == (2, T + 1, 3) and found.force.shape == (2, T, 3)
    assert torch.equal(found.pose[0], start.expand(T + 1, 3)) and (found.force[0] == 0).all()
    assert torch.equal(found.pose[1], pose)


def test_costs_are_read_with_failures(tmp_path):
    path = tmp_path / robot_files.COSTS
    path.write_text("rollout,cost\n2,1.25\n1,failed\n4,\n")
    assert robot_files.read_costs(path, 4) == {2: 1.25, 1: math.inf, 4: math.inf}
    path.write_text("roll,cost\n")
    with pytest.raises(TorchdsError, match=re.escape("the header has to be rollout,cost, it is 'roll,cost'")):
        robot_files.read_costs(path, 4)


def test_a_mark_of_failure_counts_more_than_a_recording(tmp_path):
    for k in (1, 2):
        robot_files.recording(tmp_path, k).touch()
    robot_files.failure(tmp_path, 2).touch()
    assert robot_files.returned(tmp_path, 3) == ["there", "failed", "missing"]
    (tmp_path / robot_files.COSTS).write_text("rollout,cost\n")
    with pytest.raises(TorchdsError, match="Leave one of them"):
        robot_files.returned(tmp_path, 3)
