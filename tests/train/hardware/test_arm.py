"""python -m train arm: three arms from their descriptions behind a learned motion of poses."""

import sys

import pytest
import torch

pytest.importorskip("mujoco")

from tests.arms import ARMS, write
from torchds.errors import InvalidArgumentError
from torchds.impedance import arm
from train import __main__ as train_main
from train.hardware.arm import followed


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_each_arm_follows_a_learned_motion_of_poses(name):
    """Less than 5 mm and a degree behind, and at the goal in the end; no torque is cut, and the hand does not flip."""
    posture = torch.tensor(ARMS[name].goal, dtype=torch.float64)
    found = followed(arm(ARMS[name].text, "tool"), posture, stiffness=2000.0, rotation_scale=0.02, seconds=3.0)
    assert found.distance < 5 and found.angle < 1 and found.cut == 0
    assert found.end_distance < 20 and found.end_angle < 5


@pytest.mark.slow
def test_the_command_reads_a_description_and_prints_a_line(tmp_path, capsys, monkeypatch):
    write(tmp_path)
    path, *options = capsys.readouterr().out.splitlines()[2].split()
    monkeypatch.setattr(sys, "argv", ["train", "arm", path, *options, "--seconds", "0.05"])
    assert train_main.main() == 0
    header, _, line = capsys.readouterr().out.splitlines()
    assert header.startswith("| arm | farthest behind [mm] |")
    cells = line.strip("| ").split(" | ")
    assert cells[0] == "ur5" and 0 < float(cells[1]) < 5 and cells[5] == "0"


def test_postures_that_do_not_fit_are_refused():
    ur5 = arm(ARMS["ur5"].text, "tool")
    with pytest.raises(InvalidArgumentError, match="--posture has to have 6 angles, got 2"):
        followed(ur5, torch.zeros(2).double(), 2000.0, 0.02, 1.0)
    with pytest.raises(InvalidArgumentError, match="does not reach the start of the motion from this posture"):
        followed(ur5, torch.zeros(6).double(), 2000.0, 0.02, 0.1)  # stretched out
