"""What can be said about a recording that the file does not say itself: one list of arguments for all readers.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Literal, TypedDict, TypeGuard

from torchds.arrays import check_positive
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.recordings.clock import UNITS

Column = str | int
Columns = Column | Sequence[Column]


class Reading(TypedDict, total=False):
    """Arguments of `load`, `load_csv`, `load_npz` and `load_mat`. Columns and fields are given by name, or by number from 0.

    Attributes:
        dt: time step [s], for files without a clock; one for all, or one for each demonstration of all files, None for those
            with a clock.
        time: the column or field of time.
        time_unit: of it: s, ms, us, ns or min.
        positions: the columns or the field of the positions, in this order; all others are then left out.
        velocities: those of the velocities, one for each position; [] for none.
        stiffness: those of the stiffness; [] for none.
        ignore: columns to leave out.
        names: names of the dimensions; those in the file by default.
        units: of the positions, one for all dimensions or one for each; those in the file by default.
        resample: True brings every demonstration to equal time steps by cubic splines, a number to about that time step [s],
            so that first and last sample stay; rows in which something is missing are bridged.
        duplicates: "drop" leaves out samples whose time does not rise; they are refused by default.
        split: a column that numbers the demonstrations; True to split also at jumps and gaps; False to split nowhere.
        variable: the variable of a MATLAB file, needed if several could be meant.
        time_axis: of arrays, 0 if samples are rows, 1 if they are columns; of three-dimensional ones 0, 1 or 2.
        demo_axis: of three-dimensional arrays, the axis along which the demonstrations stand.
    """

    dt: float | Sequence[float | None] | None
    time: Column | None
    time_unit: str | None
    positions: Columns | None
    velocities: Columns | None
    stiffness: Columns | None
    ignore: Columns | None
    names: Sequence[str] | None
    units: str | Sequence[str] | None
    resample: bool | float
    duplicates: Literal["refuse", "drop"]
    split: bool | Column | None
    variable: str | None
    time_axis: int | None
    demo_axis: int | None


ARRAYS = ("variable", "time_axis", "demo_axis")


def check(how: Reading, without: Collection[str] = ()) -> None:
    """Refuse arguments that there are not, or whose value cannot be meant.

    Args:
        how: of a reader.
        without: arguments that this kind of file has no use for.

    Raises:
        UnknownNameError: no argument of this name.
        InvalidArgumentError: a value that is not allowed.
    """
    known = [name for name in Reading.__annotations__ if name not in without]
    for name in how:
        if name not in known:
            raise UnknownNameError("argument of this reader", name, known)
    if how.get("time_unit") is not None and how["time_unit"] not in UNITS:
        raise UnknownNameError("time_unit", str(how["time_unit"]), UNITS)
    if how.get("duplicates", "refuse") not in ("refuse", "drop"):
        raise InvalidArgumentError(f"duplicates has to be 'refuse' or 'drop', got {how['duplicates']!r}")
    for name in ("time_axis", "demo_axis"):
        if (axis := how.get(name)) is not None and axis not in (0, 1, 2):
            raise InvalidArgumentError(
                f"{name} has to be 0 (samples are rows), 1 (samples are columns) or, of three axes, 2; got {axis!r}"
            )
    if not set(ARRAYS) <= set(without) and is_column(how.get("split")):
        raise InvalidArgumentError(
            f"split has to be True or False where demonstrations are arrays, which have no column, got {how['split']!r}"
        )
    step = how.get("resample", False)
    if not isinstance(step, bool):
        if not isinstance(step, (int, float)):
            raise InvalidArgumentError(f"resample has to be True, False or a time step in seconds, got {step!r}")
        check_positive("resample", step)


def is_column(split: bool | Column | None) -> TypeGuard[Column]:
    """Whether an argument names a column, or gives its number."""
    return isinstance(split, (str, int)) and not isinstance(split, bool)


def several(columns: Columns | None) -> list[Column] | None:
    """Columns as a list; one alone counts as a list of one."""
    if columns is None or isinstance(columns, (str, int)):
        return None if columns is None else [columns]
    return list(columns)


def said(how: Mapping[str, object], *names: str) -> bool:
    """Whether one of these arguments was given."""
    return any(how.get(name) is not None for name in names)
