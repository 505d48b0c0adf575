"""The recordings that the task learns from are those that their script makes: as many, as long, along the hand's motions."""

import pytest
import torch

from torchds import load_csv

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

from tasks.digging.demonstrate import FOLDER, SOIL, STEP, N, motions


@pytest.mark.slow
def test_the_recordings_follow_the_hand():
    """A hand of 700 N/m is firm: the tool is within a few centimetres of it all the way, soil or not."""
    recorded, hands = load_csv(FOLDER), motions(SOIL.time_step)
    assert len(recorded) == len(hands) == N
    for demo, hand in zip(recorded, hands, strict=True):
        asked = hand[:: round(STEP / SOIL.time_step)].to(demo.x)
        assert demo.dt == pytest.approx(STEP) and len(demo.x) == len(asked)
        apart = (demo.x - asked).abs()
        assert apart[:, :2].max() < 0.1 and apart[:, 2].max() < 0.3
        assert torch.linalg.vector_norm(apart[:, :2], dim=-1).median() < 0.02


def test_the_hands_differ_from_each_other_and_not_from_call_to_call():
    first, again = motions(0.1), motions(0.1)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert len({len(motion) for motion in first}) > 1
    assert all(12.5 <= (len(motion) - 1) * 0.1 <= 14.6 for motion in first)
