"""Controls of the page: each shows the value at some place in the problem's file, and asks for another one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from train.view.studio.nice import events, ui
from train.view.studio.window import Window

Place = tuple[str | int, ...]
"""Names and indices from the file inwards: `("weights", "goal")`, `("via_points", 2, 0)`."""

OFF, MOST = -6.0, 2.0  # of the logarithm of a weight
LABEL = "width: 8.5rem; font-size: 14px; line-height: 1.2"
VALUE = "width: 4rem; text-align: right; font-size: 14px"


def found(values: Any, place: Place, usual: Any = None) -> Any:
    """What stands at a place, or `usual` where nothing does."""
    for key in place:
        try:
            values = values[key]
        except (KeyError, IndexError, TypeError):
            return usual
    return values


def replaced(values: Any, place: Place, value: Any) -> Any:
    """The same values with another one at a place; a point or an object that is not there yet is begun."""
    if not place:
        return value
    key, inner = place[0], place[1:]
    if isinstance(key, int):
        items = [0.0, 0.0] if values is None else list(values)
        return [replaced(item, inner, value) if i == key else item for i, item in enumerate(items)]
    return {**(values or {}), key: replaced((values or {}).get(key), inner, value)}


def bind(
    window: Window,
    element: Any,
    place: Place,
    usual: Any = None,
    *,
    into: Callable[[Any], Any] = lambda value: value,
    out: Callable[[Any], Any] = lambda value: value,
    clears: bool = False,
) -> Any:
    """Let an element show what stands at a place, and put there what it is changed to.

    Args:
        window: of the page.
        element: of it, with a value.
        place: in the problem's file.
        usual: what is shown where nothing stands there.
        into: from the value there to that of the element.
        out: and back.
        clears: whether an empty element means that nothing stands there; else it is one in which somebody still types.
    """

    def changed(event: events.ValueChangeEventArguments[Any]) -> None:
        if window.filling or (event.value is None and not clears):
            return
        value = None if event.value is None else out(event.value)
        values = replaced(window.studio.problem.to_json(), place, value)
        window.attempt(lambda: window.studio.adjust(**{str(place[0]): values[place[0]]}))
        window.news("problem")  # what was refused is shown as it still is

    element.on_value_change(changed)
    window.controls[element] = lambda p: into(found(p, place, usual))
    return element


def slider(window: Window, label: str, place: Place, low: float, high: float, step: float, usual: Any = None) -> None:
    """A slider with its name and its value."""
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label(label).style(LABEL)
        element = ui.slider(min=low, max=high, step=step).props(f'aria-label="{label}"')
        whole = int if isinstance(step, int) and isinstance(low, int) else float
        bind(window, element, place, low if usual is None else usual, out=whole)
        ui.label().bind_text_from(element, "value", lambda n: "" if n is None else f"{n:.4g}").style(VALUE)


def weight(window: Window, label: str, place: Place) -> None:
    """A logarithmic slider that begins with off."""
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label(label).style(LABEL)
        element = ui.slider(min=OFF, max=MOST, step=0.1).props(f'aria-label="weight of {label}"')
        bind(window, element, place, into=position, out=weighed)
        ui.label().bind_text_from(element, "value", lambda n: f"{weighed(n):.3g}" if n and n > OFF else "off").style(
            VALUE
        )


def weighed(position: float) -> float:
    """Where a slider of weights stands, as a weight."""
    return 0.0 if position <= OFF else float(f"{10**position:.3g}")


def position(weight: float) -> float:
    """A weight as where its slider stands."""
    return OFF if weight <= 10**OFF else math.log10(weight)


def number(window: Window, label: str, place: Place, usual: Any = None, *, whole: bool = False, **options: Any) -> Any:
    """A number that is typed, and asked for once nothing more is typed; one with a placeholder can be left empty."""
    element = ui.number(label=label, **options).props("dense debounce=400").style("width: 6.4rem")
    return bind(window, element, place, usual, out=rounded if whole else float, clears="placeholder" in options)


def rounded(value: float) -> float:
    """A whole number where it is one; the problem says what is wrong with others."""
    return int(value) if math.isfinite(value) and value == int(value) else value


def select(window: Window, label: str, place: Place, options: Mapping[str, str], usual: Any = None, **ways: Any) -> Any:
    """One of several names."""
    element = ui.select(dict(options), label=label).props("dense options-dense").style("width: 100%")
    return bind(window, element, place, usual, **ways)


def switch(window: Window, label: str, place: Place, on: Any, off: Any) -> None:
    """Something that is there or not."""
    bind(
        window, ui.switch(label), place, into=lambda value: value not in (None, off), out=lambda yes: on if yes else off
    )


def note(text: str) -> None:
    """A sentence of explanation."""
    ui.label(text).classes("studio-note")
