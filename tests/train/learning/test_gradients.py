"""Gradients with the step that the commands give them, one for all tasks, against what PI^BB ends with."""

import pytest

from train.learning.learner import Learner
from train.options import options_for


def end(task, optimizer, rollouts, **chosen):
    """The cost after so many roll-outs with their gradients."""
    learner = Learner(options_for(task, optimizer=optimizer, updates=rollouts // 10, rollouts=10, **chosen)).learn()
    assert learner.history.rollouts[-1] == rollouts
    return learner.history.cost[-1][0]


@pytest.mark.parametrize("optimizer", ["adam", "lbfgs"])
@pytest.mark.parametrize(("shape", "bar"), [("N", 0.06), ("P", 0.03)])
@pytest.mark.slow
def test_via_points(optimizer, shape, bar):
    """PI^BB: 0.156 and 0.455."""
    assert end("via_point", optimizer, 500, shape=shape) <= bar


@pytest.mark.parametrize("optimizer", ["adam", "lbfgs"])
@pytest.mark.slow
def test_two_starts(optimizer):
    """PI^BB ends at 0.75 after 4000 roll-outs, an eighth of which is enough."""
    assert end("two_starts", optimizer, 500) < 0.75


@pytest.mark.parametrize(
    ("task", "optimizer", "pibb", "rollouts"),
    [
        ("half_plane_force", "adam", 0.625, 40),
        ("half_plane_force", "lbfgs", 0.625, 20),
        ("divergent_field", "adam", 1.549, 20),
        ("divergent_field", "lbfgs", 1.549, 20),
    ],
)
@pytest.mark.slow
def test_force_fields(task, optimizer, pibb, rollouts):
    """PI^BB ends there after 1000 roll-outs."""
    assert end(task, optimizer, rollouts) < pibb
