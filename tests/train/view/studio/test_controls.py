"""Where controls find what they show."""

import pytest

pytest.importorskip("nicegui")

from tests import drawn
from train.view.studio.controls import OFF, found, position, replaced, weighed


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
