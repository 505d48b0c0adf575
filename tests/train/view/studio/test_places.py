"""Places that are typed."""

import pytest

pytest.importorskip("nicegui")

import torch

from tasks.sketch import Sketch
from tests import drawn
from tests.train.view.studio.test_controls import Field, Problems
from train.view.studio.controls import bind, found
from train.view.studio.places import NAMES, PARTS, add, ways
from train.view.studio.window import Window


@pytest.fixture
def window():
    window = Window(Problems(drawn.problem()))
    window.studio.task = Sketch.of(drawn.problem())()
    window.studio.table = (-1.0, 1.0, -0.5, 0.5)
    return window


@pytest.mark.parametrize("name", ["start", "goal"])
def test_one_coordinate_of_the_start_or_the_goal_is_typed_and_the_other_stays(window, name):
    scene = window.studio.task.scene()
    there = scene.starts[0] if name == "start" else scene.goal
    fields = [Field(), Field()]
    for axis, field in enumerate(fields):
        bind(window, field, (name,), **ways(window, name, axis))
    window.fill()
    torch.testing.assert_close(torch.tensor([f.value for f in fields]).double(), there, atol=1e-4, rtol=0)
    fields[1].type(0.25)
    assert getattr(window.studio.problem, name) == pytest.approx((float(there[0]), 0.25), abs=1e-4)


def test_without_a_drawing_they_are_empty(window):
    window.studio.task = None
    field = Field()
    bind(window, field, ("start",), **ways(window, "start", 0))
    window.fill()
    assert field.value is None


@pytest.mark.parametrize("kind", NAMES)
def test_one_more_of_each_kind_is_put_to_the_middle_and_has_numbers(window, kind):
    before = window.studio.problem.to_json()
    add(window, kind)
    after = window.studio.problem.to_json()
    (name,) = [name for name in after if after[name] != before[name]]
    numbers = {part: found(after, (name, len(after[name]) - 1, *place)) for part, place in PARTS[kind].items()}
    expected = {
        "via": {"x1": 0.0, "x2": 0.0},
        "walls": {"from x1": 0.0, "from x2": -0.2, "to x1": 0.0, "to x2": 0.2},
        "regions": {"x1": 0.0, "x2": 0.0, "radius": 0.2},
    }
    assert numbers == pytest.approx(expected[kind])
