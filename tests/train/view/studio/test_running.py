"""Settings of learners."""

import pytest

pytest.importorskip("nicegui")

from types import SimpleNamespace

from nicegui import Client
from nicegui.page import page

from tests import drawn
from tests.train.view.studio.test_controls import Problems
from train.options import options_class
from train.searchers.named import METHODS, refuse
from train.view.studio import running
from train.view.studio.running import contender, hurry
from train.view.studio.window import Window


class Learner:
    def __init__(self, running):
        self.running, self.paces = running, []

    def go(self, pace):
        self.paces.append(pace)


def test_another_pace_is_for_those_who_learn_already():
    sides = [Learner(True), Learner(False)]
    hurry(SimpleNamespace(sides=sides), 7.0)
    assert [side.paces for side in sides] == [[7.0], []]


@pytest.mark.parametrize("condition", ["none", "seds", "p-qlf"])
@pytest.mark.parametrize("walls", [[], [[[0.0, 0.0], [0.1, 0.3]]]])
def test_the_learner_to_compare_with_can_learn_every_problem(condition, walls, tmp_path):
    problem = drawn.problem(condition=condition, walls=walls)
    drawn.problem(condition=condition, walls=walls, learners=[contender(problem)]).write(tmp_path / "problem.json")
    options = options_class(str(tmp_path / "problem.json"))()
    assert options.exploration == ("homogeneous" if condition == "none" else "stable")
    if options.optimizer in METHODS:
        refuse(options, options.make_task())
    else:
        assert walls and (options.optimizer, options.shrink) == ("surrogate", "all")


def test_how_stable_noise_is_made_is_asked_where_there_is_some():
    window = Window(Problems(drawn.problem()))
    with Client(page("/")):
        running.learner(window, 0)
    (shrink,) = (element for element in window.controls if element._props["label"] == "stable noise")
    for fields, shown, value in (
        ({}, False, "all"),
        ({"condition": "seds", "learners": [{"shrink": "none"}]}, True, "none"),
        ({"condition": "seds", "learners": [{"exploration": "trajectory"}]}, False, "all"),
        ({"condition": "seds", "learners": [{"exploration": "stable-trajectory"}]}, True, "all"),
    ):
        window.studio.problem = drawn.problem(**fields)
        window.fill()
        assert (shrink.visible, shrink.value) == (shown, value)
    shrink.value = "direction"
    assert window.studio.problem.learners[0]["shrink"] == "direction"
