"""Where controls find what they show."""

import pytest

pytest.importorskip("nicegui")

from dataclasses import replace
from types import SimpleNamespace

from tests import drawn
from train.view.studio.controls import OFF, bind, found, position, replaced, rounded, weighed
from train.view.studio.window import Window


class Problems:
    """A state without processes."""

    def __init__(self, problem):
        self.problem, self.task = problem, None

    def adjust(self, **fields):
        self.problem = replace(self.problem, **fields)

    change = adjust

    def put(self, problem):
        self.problem = problem


class Field:
    """An element with a value that somebody types."""

    value = None

    def on_value_change(self, call):
        self.call = call

    def type(self, value):
        self.value = value
        self.call(SimpleNamespace(value=value))


def test_a_value_is_found_and_replaced_where_it_stands_and_nothing_else_changes():
    p = drawn.problem(body={"stiffness": 50.0}).to_json()
    for place, value in {
        ("samples",): 55,
        ("weights", "goal"): 3.0,
        ("via_points", 0, 1): -0.5,
        ("body", "force", 1): 2.0,
        ("learners", 0, "noise"): 0.2,
        ("start", 1): 0.3,
    }.items():
        after = replaced(p, place, value)
        assert found(after, place) == value and drawn.Problem.from_json(after)
        assert {name: v for name, v in after.items() if name != place[0]} == {
            name: v for name, v in p.items() if name != place[0]
        }
    assert p == drawn.problem(body={"stiffness": 50.0}).to_json()


def test_what_is_not_there_is_as_usual():
    p = drawn.problem().to_json()
    assert found(p, ("body", "mass"), 7) == 7 and found(p, ("learners", 1, "runs"), 3) == 3
    assert found(p, ("start", 0)) is None


@pytest.mark.parametrize("weight", [0.0, 1e-4, 0.123, 1.0, 37.5])
def test_a_weight_stands_where_it_is_read_from(weight):
    assert weighed(position(weight)) == pytest.approx(weight, rel=1e-3)


def test_off_is_nothing():
    assert weighed(OFF) == 0.0 and position(0.0) == OFF


def test_a_number_that_need_not_be_there_can_be_taken_away_again():
    window, noise, seed = Window(Problems(drawn.problem())), Field(), Field()
    bind(window, noise, ("learners", 0, "noise"), clears=True)
    bind(window, seed, ("learners", 0, "seed"), 0)
    for field, value in {noise: 0.3, seed: 4}.items():
        field.type(value)
        field.type(None)
    assert window.studio.problem.learners[0]["noise"] is None and window.studio.problem.learners[0]["seed"] == 4
    window.fill()
    assert noise.value is None and seed.value == 4


@pytest.mark.parametrize(
    "typed, kept", [(3.0, 3), (-1.0, -1), (2.5, 2.5), (float("inf"), float("inf")), (1e300, 10**300)]
)
def test_whole_numbers_are_whole_and_others_are_left_to_be_refused(typed, kept):
    found = rounded(typed)
    assert found == pytest.approx(kept) and isinstance(found, int) == (typed not in (2.5, float("inf")))
