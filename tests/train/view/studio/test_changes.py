"""What the pointer does to a problem."""

from dataclasses import replace

import pytest
import torch

from tests import drawn
from torchds import Demonstrations
from torchds.errors import InvalidArgumentError
from train.view.studio import changes


def changed(before, fields):
    return replace(before, **fields)


def test_a_stroke_keeps_its_timing_whatever_the_clock():
    points = [(1000.0 + t, x1, x2) for t, x1, x2 in drawn.stroke(0.1)]
    after = changed(drawn.problem(), changes.stroke(drawn.problem(), points))
    assert len(after.strokes) == 3 and after.strokes[2][0][0] == 0.0
    for row, (t, x1, x2) in zip(after.strokes[2], drawn.stroke(0.1), strict=True):
        assert row == pytest.approx((t, x1, x2), abs=1e-4)


def test_a_dot_is_no_motion():
    with pytest.raises(InvalidArgumentError, match="too short for a motion"):
        changes.complete([(0.1 * i, 0.5, 0.5) for i in range(200)])
    changes.complete(drawn.stroke())


def test_a_long_stroke_is_thinned_to_its_end():
    points = [(0.001 * i, 1e-5 * i, 0.0) for i in range(12_001)]
    rows = changed(drawn.problem(), changes.stroke(drawn.problem(), points)).strokes[-1]
    assert 4000 <= len(rows) <= 5000 and rows[-1] == (12.0, pytest.approx(0.12), 0.0)


def test_small_strokes_keep_their_shape():
    points = [(t, 1e-5 * x1, 1e-5 * x2) for t, x1, x2 in drawn.stroke()]
    rows = changed(drawn.problem(), changes.stroke(drawn.problem(), points)).strokes[-1]
    assert [row[1:] for row in rows] == [tuple(point[1:]) for point in points]


@pytest.mark.parametrize("kind", ["walls", "regions"])
def test_a_click_is_neither_a_wall_nor_a_region(kind):
    with pytest.raises(InvalidArgumentError, match="two places"):
        changes.placed(drawn.problem(), kind, (0.1, 0.2), [0.1, 0.2])


def test_recordings_stand_beside_the_drawing_at_their_own_pace():
    x = torch.stack([torch.linspace(0, 1, 6001), torch.zeros(6001)], -1).double()
    after = changed(drawn.problem(), changes.recorded(drawn.problem(), Demonstrations([x], dt=0.001)))
    assert len(after.strokes) == 3
    times = [row[0] for row in after.strokes[2]]
    assert len(times) <= 2001 and times[-1] == pytest.approx(6.0, abs=0.01)
    assert after.unit == "m"
    empty = changed(drawn.problem(), {"strokes": ()})
    first = changed(empty, changes.recorded(empty, Demonstrations([x], dt=0.001, units="mm")))
    assert first.unit == "mm"


@pytest.mark.parametrize(
    "units, words", [("mm", "the drawing is in m, these motions are in mm; clear"), (("m", "rad"), "m and rad")]
)
def test_recordings_in_another_unit_are_refused(units, words):
    demos = Demonstrations([torch.rand(9, 2)], dt=0.1, units=units)
    with pytest.raises(InvalidArgumentError, match=words):
        changes.recorded(drawn.problem(), demos)


@pytest.mark.parametrize("drawn_in, recorded_in, kept", [("m", "m", "m"), ("m", "", "m"), ("", "mm", "")])
def test_where_a_unit_is_not_known_recordings_are_taken(drawn_in, recorded_in, kept):
    demos = Demonstrations([torch.rand(9, 2)], dt=0.1, units=recorded_in)
    p = drawn.problem(unit=drawn_in)
    assert changed(p, changes.recorded(p, demos)).unit == kept
    empty = drawn.problem(unit="km", strokes=[])
    assert changed(empty, changes.recorded(empty, demos)).unit == recorded_in


def test_a_short_recording_beside_a_long_one_stays_whole():
    long = torch.stack([torch.linspace(0, 1, 12_001), torch.zeros(12_001)], -1).double()
    short = torch.stack([torch.linspace(0, 1, 20), torch.ones(20)], -1).double()
    demos = Demonstrations([long, short], dt=0.001)
    after = changed(drawn.problem(), changes.recorded(drawn.problem(), demos)).strokes[2:]
    assert 1000 < len(after[0]) <= 2000 and len(after[1]) == 20
    for rows, x in zip(after, (long, short), strict=True):
        times = torch.tensor(rows, dtype=torch.float64)[:, 0]
        torch.testing.assert_close(torch.tensor(rows).double()[:, 1:], x[(times / 0.001).round().long()])
        assert rows[-1] == pytest.approx((0.001 * (len(x) - 1), *x[-1].tolist()))


def test_a_motion_in_space_is_refused():
    with pytest.raises(InvalidArgumentError, match="2 dimensions, got 3"):
        changes.recorded(drawn.problem(), Demonstrations([torch.rand(9, 3)], dt=0.1))


def test_places_come_move_and_go():
    p = drawn.problem()
    p = changed(p, changes.placed(p, "via", (0, 0), (0.5, 0.25)))
    p = changed(p, changes.placed(p, "walls", (0, 0), (0.5, 0.5)))
    p = changed(p, changes.placed(p, "regions", (0.1, 0.1), (0.4, 0.5)))
    assert p.via_points[1] == (0.5, 0.25) and p.walls == (((0, 0), (0.5, 0.5)),)
    assert p.regions[0]["radius"] == pytest.approx(0.5)
    p = changed(p, changes.dragged(p, "via", 0, (0.9, -0.9)))
    p = changed(p, changes.dragged(p, "goal", 0, (0.7, 0.1)))
    assert p.via_points == ((0.9, -0.9), (0.5, 0.25)) and p.goal == (0.7, 0.1)
    for kind in ("via", "walls", "regions", "strokes"):
        p = changed(p, changes.erased(p, kind, 0))
    assert p.via_points == ((0.5, 0.25),) and not p.walls and not p.regions and len(p.strokes) == 1
