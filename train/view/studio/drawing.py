"""The table on which motions are drawn, as an element of the page; what it looks like stands in drawing.js."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from train.view.studio.nice import Element, events

Said = dict[str, Any]
EVENTS = ("ready", "stroke", "place", "drag", "erase", "pull")


class Drawing(Element, component="drawing.js"):
    """Shows layers, and says what the pointer does.

    Events, each with a dict: `ready`, the table is there, or has another `width` and `height`. `stroke`, of `points`
    `[t, x, y]` so far, `done` at its end. `place`, of a `kind` (via, walls, regions), `from` here `to` there. `drag`, of the
    start, the goal or a via-point by `kind` and `index`, `at` a point, `done` at the end. `erase`, of the thing by `kind` and
    `index`. `pull`, `at` a point, or None when it is let go.

    Args:
        label: what it is, for those who hear the page.
        heard: what is called with the dict of an event, by the event's name.
        active: whether it listens to the pointer.
    """

    def __init__(self, label: str, heard: Mapping[str, Callable[[Said], object]], *, active: bool = True) -> None:
        super().__init__()
        self._props.update(label=label, tool="draw", active=active)
        for name, call in heard.items():
            self.on(name, _with(call))

    def use(self, tool: str) -> None:
        """What the pointer does from now on: draw, move, via, wall, region, erase or pull."""
        self._props["tool"] = tool
        self.update()

    def show(self, **layers: Any) -> None:
        """Show these layers in place of what they were; the others stay."""
        self.run_method("show", layers)


def _with(call: Callable[[Said], object]) -> Callable[[events.GenericEventArguments], object]:
    return lambda event: call(event.args)
