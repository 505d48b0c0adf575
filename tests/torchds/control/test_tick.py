"""The ring of ticks."""

from torchds.control.plan import Cut
from torchds.control.tick import ring


def test_ticks_are_rows_of_one_array():
    ticks = ring(3, 2, 3, 1)
    assert [part.shape for part in (ticks[0].x, ticks[0].v, ticks[0].stiffness)] == [(2,), (3,), (1,)]
    ticks[1]._row[:] = range(6)
    assert ticks[1].x.tolist() == [0, 1] and ticks[1].v.tolist() == [2, 3, 4] and ticks[1].stiffness.tolist() == [5]
    assert ticks[0].x.base is not None and not ticks[0].v.any()


def test_a_tick_says_what_was_cut():
    (tick,) = ring(1, 1, 1, 0)
    tick.cut = Cut.SPEED | Cut.WORKSPACE
    assert tick.reasons == ("speed", "workspace") and "cut=('speed', 'workspace')" in repr(tick)
