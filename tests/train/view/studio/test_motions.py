"""Motions that begin or end elsewhere."""

import time

import pytest
import torch

from tasks.sketch import Sketch
from tests import drawn
from train.view.studio.motions import motion


@pytest.fixture(scope="module")
def task():
    return Sketch.of(drawn.problem())()


def test_motions_begin_and_end_where_they_are_dragged_to(task):
    policy = task.policy()
    x = motion(task, policy)
    torch.testing.assert_close(x, task.rollout(policy).x.detach())
    start = torch.tensor([0.2, 0.5], dtype=torch.float64)
    assert motion(task, policy, start=start)[0].equal(start)
    moved = motion(task, policy, start=x[0] + 0.25, goal=task.goal + 0.25)
    torch.testing.assert_close(moved, x + 0.25, rtol=0, atol=1e-9)


def test_a_start_is_dragged_within_a_picture(task):
    policy, start = task.policy(), torch.tensor([0.2, 0.5], dtype=torch.float64)
    motion(task, policy, start=start)
    seconds = []
    for _ in range(9):
        began = time.thread_time()
        motion(task, policy, start=start)
        seconds.append(time.thread_time() - began)
    assert min(seconds) < 1 / 60
