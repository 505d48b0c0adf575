"""The settings beside the table, as tabs, and what is said in words."""

from __future__ import annotations

from train.view.studio import asking, running
from train.view.studio.nice import ui
from train.view.studio.state import Studio
from train.view.studio.window import Window

ROOMS = {
    "Draw": asking.drawing,
    "Imitate": asking.imitating,
    "Ask": asking.asking,
    "Learn": running.learning,
    "Push": running.pushing,
    "Keep": running.taking,
}


def build(window: Window) -> None:
    """All settings, as tabs."""
    with ui.tabs().props('dense align=left no-caps inline-label aria-label="settings"') as tabs:
        for name in ROOMS:
            ui.tab(name)
    with ui.tab_panels(tabs, value="Draw", keep_alive=True).style("width: 100%"):
        for name, room in ROOMS.items():
            with ui.tab_panel(name).style("padding: 8px 0; gap: 6px"):
                room(window)


def said(studio: Studio) -> str:
    """What there is to say below the table, in a line."""
    parts = []
    known = studio.imitation
    if studio.imitating:
        parts.append("imitating …")
    elif studio.complaint:
        parts.append(studio.complaint)
    elif known is not None:
        parts.append(f"imitated in {known.seconds:.2f} s")
    elif not studio.problem.strokes:
        parts.append("Draw a motion on the table: press, move, let go.")
    for i, side in enumerate(studio.sides[: len(studio.problem.learners)]):
        picture, stale = studio.fresh(i), side.stale(studio.problem)
        if side.complaint and not stale:
            parts.append(side.complaint)
        if picture is not None:
            cost = picture.curves["total"]
            parts.append(
                f"{'AB'[i]}: update {picture.done} of {picture.of}, cost {cost[-1]:.3g}, at the start {cost[0]:.3g}"
            )
            if picture.done >= picture.of:
                parts.append("all updates are made: Reset begins anew")
        elif stale:
            parts.append(f"{'AB'[i]} has learned an earlier version of the problem; Go begins anew")
    return " · ".join(parts)
