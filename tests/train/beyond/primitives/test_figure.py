"""The figure: a line for each letter, a curve for each row, a track for every second direction."""

import numpy as np
import pytest

import tasks
from train.beyond.primitives.command import Primitives
from train.beyond.primitives.figure import LEARNERS, PANELS, draw


@pytest.mark.slow
def test_every_row_and_every_disturbance_is_drawn():
    command = Primitives(runs=2, updates=1)
    rows = [command.row(tasks.make("via_point", system=system), "recommended") for system in ("gmr", "dmp")]
    seen = [each for row in rows for each in command.disturbed(row)]
    figure = draw(rows, seen)
    assert len(figure.axes) == 1 + len(PANELS)
    learning, pushed, held, begun = figure.axes
    for line, row in zip(learning.lines, rows, strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.median(row.cost, 1))
        assert line.get_color() == LEARNERS["recommended"]
    tracks = [sum(len(line.get_xdata()) > 100 for line in axes.lines) for axes in (pushed, held, begun)]
    assert tracks == [2 * (1 + 4), 2 * (1 + 1), 2 * (1 + 4)]  # undisturbed, and every second direction
    assert all(axes.get_xlabel() == "x [4 mm]" for axes in (pushed, held, begun))
