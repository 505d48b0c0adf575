"""Recordings of the simulated arm in gravel are believed at every stiffness and with both explorations, gross errors are named.

`honest.npz` has what the simulation made of four roll-outs each, every 0.2 s: asked poses `(4, T+1, 3)`, measured ones, forces
`(4, T, 3)` and stiffness `(4, T)`, made with `LwrDigging(grains="coarse", seed=0)` from the first update of a session.
"""

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

from tests.faults.test_sessions import WRONG
from train.hardware.questions import LARGE, question, rms
from train.hardware.robot_files import Recorded

DT = 0.2
NUMBERS = [1, 2, 3, 4]
PLACES = [(exploration, s0) for exploration in ("homogeneous", "trajectory") for s0 in (75, 150, 300, 700)]


def honest(exploration, s0):
    """Recordings, asked poses and stiffness."""
    with np.load(Path(__file__).with_name("honest.npz")) as file:
        found = [
            torch.from_numpy(file[f"{exploration}-{s0}-{name}"]).double()
            for name in ("pose", "force", "asked", "stiffness")
        ]
    return Recorded(*found[:2]), *found[2:]


@pytest.mark.parametrize(("exploration", "s0"), PLACES)
def test_what_the_simulated_arm_did_is_believed(exploration, s0):
    recorded, asked, stiffness = honest(exploration, s0)
    assert question(NUMBERS, recorded, asked, stiffness, DT) == []


def test_a_softer_arm_deviates_more_and_none_as_much_as_would_be_questioned():
    shares = []
    for exploration, s0 in PLACES:
        recorded, asked, _ = honest(exploration, s0)
        lever = torch.tensor([1.0, 1.0, 0.2])
        q, u = (((x - x[:, :1]) * lever).numpy() for x in (recorded.pose, asked))
        shares.append(max(rms(a - b) / rms(b) for a, b in zip(q, u, strict=True)))
    assert shares[:4] == sorted(shares[:4], reverse=True) and shares[4:] == sorted(shares[4:], reverse=True)
    assert max(shares) < LARGE


@pytest.mark.parametrize("change", WRONG)
@pytest.mark.parametrize(("exploration", "s0"), PLACES)
def test_gross_errors_are_named(exploration, s0, change):
    recorded, asked, stiffness = honest(exploration, s0)
    change(*recorded)
    found = question(NUMBERS, recorded, asked, stiffness, DT)
    assert WRONG[change] in {(finding.name, finding.rollouts) for finding in found if finding.gross}
    assert {k for finding in found for k in finding.rollouts} == set(WRONG[change][1])  # and no other one is doubted


@pytest.mark.parametrize(("exploration", "s0"), PLACES)
def test_every_other_order_is_found_and_the_right_one_is_not_doubted(exploration, s0):
    recorded, asked, stiffness = honest(exploration, s0)
    for order in permutations(range(4)):
        shuffled = Recorded(recorded.pose[list(order)], recorded.force[list(order)])
        found = question(NUMBERS, shuffled, asked, stiffness, DT)
        wrong = tuple(k for k, i in zip(NUMBERS, order, strict=True) if k != i + 1)
        assert [finding.rollouts for finding in found if finding.name == "swapped"] == ([wrong] if wrong else [])


def test_roll_outs_that_hardly_differ_are_not_taken_for_each_other():
    for exploration, s0 in PLACES:
        recorded, asked, stiffness = honest(exploration, s0)
        for share in (0.0, 0.03, 0.1, 0.3):
            nearer = asked.mean(0) + share * (asked - asked.mean(0))
            moved = Recorded(nearer + recorded.pose - asked, recorded.force)
            assert "swapped" not in {finding.name for finding in question(NUMBERS, moved, nearer, stiffness, DT)}
