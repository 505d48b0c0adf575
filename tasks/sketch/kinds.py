"""What a value in a file may be. A kind takes a value and its place, and gives the value as it is kept, or refuses it.

Kinds are made of kinds, so that a file format is one table of them, and each refusal says the place, what is allowed there and
what was found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from torchds.arrays import shown
from torchds.errors import InvalidArgumentError, UnknownNameError

Kind = Callable[[str, Any], Any]
"""(place, value) -> the value as it is kept."""


def refused(where: str, allowed: str, value: Any, advice: str = "") -> InvalidArgumentError:
    """The error about a value."""
    return InvalidArgumentError(f"{where} has to be {allowed}, got {shown(value)}{advice and f'; {advice}'}")


def number(low: float, high: float) -> Kind:
    """A finite number from `low` to `high`, kept as a float."""

    def kind(where: str, value: Any) -> float:
        real = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not real or not low <= value <= high:
            raise refused(where, f"a number from {low:g} to {high:g}", value)
        return float(value)

    return kind


def whole(low: int, high: int) -> Kind:
    """A whole number from `low` to `high`."""

    def kind(where: str, value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise refused(where, f"a whole number from {low} to {high}", value)
        return value

    return kind


def window(where: str, value: Any) -> int:
    """The window of a filter: an odd number of samples, or 0 for no filter."""
    n: int = whole(0, 501)(where, value)
    if n and (n % 2 == 0 or n < 5):
        raise refused(where, "0 for none, or an odd number from 5 to 501", value)
    return n


def text(most: int) -> Kind:
    """A text of at most so many characters on one line."""

    def kind(where: str, value: Any) -> str:
        if not isinstance(value, str) or len(value) > most or not (value.isprintable()):
            raise refused(where, f"a text of at most {most} characters on one line", value)
        return value

    return kind


def one_of(*names: str) -> Kind:
    """One of some names."""

    def kind(where: str, value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise refused(where, " or ".join(map(repr, names)), value)
        return value

    return kind


def maybe(kind: Kind) -> Kind:
    """None, JSON's null, or what another kind takes."""
    return lambda where, value: None if value is None else kind(where, value)


def many(kind: Kind, least: int, most: int, what: str = "entries") -> Kind:
    """A list of `least` to `most` values of a kind, kept as a tuple."""

    def kinds(where: str, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, (list, tuple)):
            raise refused(where, f"a list of {what}", value)
        if not least <= len(value) <= most:
            allowed = f"{least}" if least == most else f"{least} to {most}"
            raise InvalidArgumentError(f"{where} has to have {allowed} {what}, got {len(value)}")
        return tuple(kind(f"{where}[{i}]", each) for i, each in enumerate(value))

    return kinds


def record(**parts: tuple[Kind, Any]) -> Kind:
    """An object with names, each with its kind and what it is where it is left out."""

    def kind(where: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise refused(where, f"an object with {', '.join(parts)}", value)
        for name in value:
            if name not in parts:
                raise UnknownNameError(f"name in {where}", str(name), parts)
        return {name: part(f"{where}.{name}", value.get(name, usual)) for name, (part, usual) in parts.items()}

    return kind


def rising_rows(most: int, latest: float, largest: float) -> Kind:
    """Rows (t [s], x1, x2) with times that rise from row to row; of rows with the same time the first one is kept."""
    limits = np.array([latest, largest, largest])

    def kind(where: str, value: Any) -> tuple[tuple[float, ...], ...]:
        allowed = f"rows [t, x1, x2] of finite numbers, t [s] of size up to {latest:g}, x1 and x2 up to {largest:g}"
        if not isinstance(value, (list, tuple, np.ndarray)):
            raise refused(where, allowed, value)
        if len(value) > most:
            raise InvalidArgumentError(f"{where} has to have at most {most} rows, got {len(value)}; leave some out")
        try:
            rows = np.asarray(value)
        except (ValueError, OverflowError):  # rows of different lengths
            rows = np.empty(0, dtype=object)
        if len(value) and (rows.dtype.kind not in "iuf" or rows.ndim != 2 or rows.shape[1] != 3):
            raise refused(where, allowed, value)
        rows = rows.reshape(-1, 3).astype(float)
        wrong = np.flatnonzero(~(np.abs(rows) <= limits).all(-1))
        if len(wrong):
            raise refused(f"{where}[{wrong[0]}]", allowed, rows[wrong[0]].tolist())
        steps = np.diff(rows[:, 0])
        if len(back := np.flatnonzero(steps < 0)):
            before, after = rows[back[0] : back[0] + 2, 0].tolist()
            raise InvalidArgumentError(
                f"the times of {where} have to rise, they go back from {before!r} to {after!r} s at row {back[0] + 1}"
            )
        rows = rows[np.concatenate([[True], steps > 0])] if len(rows) else rows
        if len(rows) < 2 or not np.ptp(rows[:, 1:], axis=0).any():
            found = f"{len(rows)} at one place" if len(rows) > 1 else len(rows)
            raise InvalidArgumentError(
                f"{where} has to have at least two points at different times and places, got {found}; draw a line"
            )
        return tuple(map(tuple, rows.tolist()))

    return kind


def option(where: str, value: Any) -> Any:
    """A value of an option of the training command: a name of it, a number, a truth or nothing; never a place of code."""
    if isinstance(value, str):
        if not value.replace("-", "_").isidentifier():
            raise refused(where, "a name that the training command knows", value, "give a place on the command line")
    elif isinstance(value, float) and not math.isfinite(value):
        raise refused(where, "finite", value)
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise refused(where, "a whole number below 2^63 in size", value)
    elif not isinstance(value, (bool, int, float, type(None))):
        raise refused(where, "a name, a number, true, false or null", value)
    return value


def options(where: str, value: Any) -> dict[str, Any]:
    """Options of the training command by name; whether they exist is for the command to say."""
    if not isinstance(value, Mapping):
        raise refused(where, "an object of options by name", value)
    return {str(name): option(f"{where}.{name}", each) for name, each in value.items()}
