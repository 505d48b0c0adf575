"""Where things are, to be typed: the start, the goal, via-points, walls and regions."""

from __future__ import annotations

from typing import Any

from train.view.studio import changes
from train.view.studio.controls import Place, bind, found, number
from train.view.studio.nice import ui
from train.view.studio.window import Window

NAMES = {"via": "via-point", "walls": "wall", "regions": "region"}
PARTS: dict[str, dict[str, Place]] = {
    "via": {"x1": (0,), "x2": (1,)},
    "walls": {"from x1": (0, 0), "from x2": (0, 1), "to x1": (1, 0), "to x2": (1, 1)},
    "regions": {"x1": ("center", 0), "x2": ("center", 1), "radius": ("radius",)},
}
SIZE = 0.1  # of what is put to the middle of the table, in its widths


def ends(window: Window) -> None:
    """Numbers for the start and the goal: where they are, given or as drawn."""
    for name in ("start", "goal"):
        with ui.element("div").classes("studio-row"):
            for axis in range(2):
                element = ui.number(label=f"{name}, x{axis + 1}", step=0.01).props("dense debounce=400")
                bind(window, element.style("width: 6.4rem"), (name,), **ways(window, name, axis))
            as_drawn = ui.button("As drawn", on_click=lambda name=name: window.change(**{name: None}))
            as_drawn.props(f'flat dense aria-label="{name} as drawn"')


def ways(window: Window, name: str, axis: int) -> dict[str, Any]:
    """From a point in the file, or that of the demonstrations where none is given, to its coordinate, and back."""

    def point(given: list[float] | None) -> list[float] | None:
        if given is not None or window.studio.task is None:
            return given
        scene = window.studio.task.scene()
        return [float(f"{x:.5g}") for x in (scene.starts[0] if name == "start" else scene.goal).tolist()]

    def moved(x: float) -> list[float]:
        here = point(found(window.studio.problem.to_json(), (name,))) or [0.0, 0.0]
        return [float(x) if i == axis else y for i, y in enumerate(here)]

    return {"into": lambda given: None if (here := point(given)) is None else here[axis], "out": moved}


def things(window: Window, kind: str) -> None:
    """Numbers for each via-point, wall or region, with a button that removes it, and one that adds another."""
    studio, name, field = window.studio, NAMES[kind], changes.LISTS[kind]
    column = ui.column().style("gap: 2px; width: 100%")
    shown: dict[str, Any] = {"n": 0, "elements": []}

    def tell() -> None:
        if (n := len(getattr(studio.problem, field))) == shown["n"]:
            return
        for element in shown["elements"]:
            del window.controls[element]
        column.clear()
        with column:
            shown.update(n=n, elements=[each for i in range(n) for each in row(i)])
        window.fill()

    def row(i: int) -> list[Any]:
        with ui.element("div").classes("studio-row"):
            parts = [
                number(window, f"{name} {i + 1}, {part}", (field, i, *place), step=0.01)
                for part, place in PARTS[kind].items()
            ]
            remove = ui.button(icon="delete", on_click=lambda: window.change(**changes.erased(studio.problem, kind, i)))
            remove.props(f'flat dense aria-label="remove {name} {i + 1}"')
        return parts

    ui.button(f"Add a {name}", on_click=lambda: window.attempt(lambda: add(window, kind)))
    window.tellers.append(tell)


def add(window: Window, kind: str) -> None:
    """One more, in the middle of the table."""
    left, right, low, high = window.studio.table
    x, y, size = (left + right) / 2, (low + high) / 2, SIZE * (right - left)
    begin = (x, y - size if kind == "walls" else y)
    window.studio.change(**changes.placed(window.studio.problem, kind, begin, (x, y if kind == "via" else y + size)))
