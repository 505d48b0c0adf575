"""Tables of demonstrations in text files.

Stability: stable.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from torchds.demonstrations import Demonstrations
from torchds.errors import DemonstrationWarning, FileError, InvalidArgumentError
from torchds.files import existing
from torchds.recordings.base import from_records
from torchds.recordings.clock import UNITS, seconds
from torchds.recordings.columns import Named, named, time_unit
from torchds.recordings.layout import Layout, layout
from torchds.recordings.parts import Record, by_number, split
from torchds.recordings.reading import ARRAYS, Reading, check, is_column, said
from torchds.recordings.text import Text, is_missing, is_number, read_text

WANTED = ("time", "position", "velocity", "stiffness")
SUFFIXES = (".csv", ".txt", ".tsv", ".dat")


def load_csv(paths: str | Path | Sequence[str | Path], **how: Unpack[Reading]) -> Demonstrations:
    """Demonstrations from tables in text files, one or several in each; all files have the same columns.

    Cells are separated by commas, semicolons, tabs or spaces; decimals have a point or a comma; lines that begin with # or %
    are comments, of which the last one before the numbers may be the header. Time, positions, velocities, stiffness and a
    column that numbers the demonstrations are recognised by their usual names and units, so are counters, second clocks,
    forces and accelerations, which are left out; columns of text or without numbers are ignored. Where it cannot be told which
    columns are positions, none is guessed. A new demonstration begins where its number changes or time starts anew.

    Args:
        paths: a file, a folder whose `*.csv` are read in the order of their names, or a sequence of files.
        **how: see `Reading`; docs/data.md has a table of forms and calls.

    Raises:
        FileError: a file is missing, is not a table, it cannot be told what its columns are, or its time steps are not
            equal to one part in a thousand; the message gives the place and the argument that helps.
        UnknownNameError: a column that is not there.
        InvalidArgumentError: an argument out of its range.
    """
    check(how, without=ARRAYS)
    files = _csv_files(paths)
    records: list[Record] = []
    places: list[str] = []
    first: list[str] | None = None
    order: dict[str, list[str]] = {}
    for path in files:
        text = read_text(path)
        header = names_of(path, text, how)
        if first is None:
            first = header
        elif set(header) != set(first):
            raise FileError(
                f"{path}: the columns are {', '.join(header)} but those of {files[0]} are {', '.join(first)}; "
                "give all files the same columns"
            )
        columns = [named(name) for name in header]
        chosen = _layout(path, text, header, columns, how)
        chosen = _in_order(path, chosen, header, order, how) if order else chosen
        order = order or {field: [header[i] for i in getattr(chosen, field)] for field in ("x", "v", "stiffness")}
        parts = _records(path, text, header, columns, chosen, how)
        records += parts
        places += [f"{path}: demonstration {i}" if len(parts) > 1 else str(path) for i in range(len(parts))]
    units = [columns[i].unit for i in chosen.x]
    demos = from_records(
        Path(", ".join(map(str, files))), records, how, places=places, names=_names(columns, chosen), units=units
    )
    demos.check().warn()
    return demos


def _names(columns: Sequence[Named], chosen: Layout) -> list[str]:
    return [columns[i].name for i in chosen.x]


def _in_order(
    path: Path, chosen: Layout, header: Sequence[str], first: Mapping[str, list[str]], how: Reading
) -> Layout:
    """The layout with its columns in the order of those of the first file, but for what the arguments say.

    Raises:
        FileError: they are other columns.
    """
    for field, said_by in (("x", ("positions",)), ("v", ("positions", "velocities")), ("stiffness", ("stiffness",))):
        if said(how, *said_by):
            continue
        names = [header[i] for i in getattr(chosen, field)]
        if set(names) != set(first[field]):
            raise FileError(
                f"{path}: {field} is read from {', '.join(names) or 'no column'}, in the file before from "
                f"{', '.join(first[field]) or 'none'}; say which are meant, "
                f"{said_by[-1]}=({', '.join(map(repr, first[field]))}), or read the files apart"
            )
        chosen = chosen._replace(**{field: [header.index(name) for name in first[field]]})  # type: ignore[arg-type]
    return chosen


def names_of(path: Path, text: Text, how: Reading) -> list[str]:
    """The header; numbers as names where there is none and the arguments say what the columns are.

    Raises:
        FileError: no header, a name that stands twice, or fewer than two samples.
    """
    if text.header is None:
        n = len(text.cells[0]) if text.cells else 0
        if not said(how, "positions"):
            raise FileError(
                f"{path}: no header; the first line has to hold the names of the columns, or say what the {n} columns are, "
                f"counted from 0: time=0, positions={tuple(range(1, n))!r} (values are separated by {text.form})"
            )
        return [str(i) for i in range(n)]
    header = text.header
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated or "" in header:
        problem = f"the name {repeated[0]!r} twice" if repeated and repeated[0] else "a column without a name"
        raise FileError(f"{path}: the header has {problem}; give every column its own name")
    if len(text.cells) < 2:
        raise FileError(f"{path}: at least two samples are needed, got {len(text.cells)}; leave it out")
    return header


def _layout(path: Path, text: Text, header: list[str], columns: list[Named], how: Reading) -> Layout:
    def usable(i: int) -> bool:
        """Columns without any number are of no use, nor are words; but words among numbers are a fault."""
        if all(is_missing(row[i]) for row in text.cells):
            return False
        return columns[i].kind in WANTED or not text.is_text(i) or np.isfinite(text.numbers(i)).mean() > 0.5

    if len(header) < 2 and text.is_text(0):
        raise FileError(
            f"{path}, line {text.lines[0]}, column {header[0]!r}: {text.cells[0][0]!r} is not a finite number (values are "
            f"separated by {text.form})"
        )
    chosen = layout(path, columns, header, usable, how)
    if chosen.demo is not None and not is_column(how.get("split")):
        numbers = text.numbers(chosen.demo)
        if np.count_nonzero(np.diff(numbers)) > len(numbers) / 2:  # another one in nearly every row: a counter
            chosen = chosen._replace(demo=None, left_out=chosen.left_out | {header[chosen.demo]: "counter"})
    if chosen.left_out:
        listed = ", ".join(f"{name} ({kind})" for name, kind in chosen.left_out.items())
        warnings.warn(
            f"{path}: left out are {listed}; choose with positions=, or pass ignore={tuple(chosen.left_out)!r}",
            DemonstrationWarning,
            stacklevel=3,
        )
    return chosen


def _records(
    path: Path, text: Text, header: list[str], columns: list[Named], chosen: Layout, how: Reading
) -> list[Record]:
    """The demonstrations in one file."""
    bridged = bool(how.get("resample"))
    last = _last_row(text, [*chosen.x, *chosen.t])
    record: Record = {}
    for field, numbers in (("x", chosen.x), ("v", chosen.v), ("stiffness", chosen.stiffness)):
        if numbers:
            record[field] = np.stack([text.numbers(i) for i in numbers], -1)
            _check(path, text, header, numbers, last, bridged)
    if chosen.t:
        _check(path, text, header, chosen.t, last, bridged)
        record["t"] = _clock(path, text, columns, chosen.t, how, last)
    if len(record["x"]) < 2:
        raise FileError(f"{path}: at least two samples are needed, got {len(record['x'])}; leave it out")
    if chosen.demo is None:
        return split(str(path), record, how, text.breaks)
    if text.is_text(chosen.demo):
        cells = [row[chosen.demo].strip() for row in text.cells]
        numbers_of = {cell: i for i, cell in enumerate(dict.fromkeys(cells))}
        return by_number(str(path), record, np.array([numbers_of[cell] for cell in cells], dtype=float))
    return by_number(str(path), record, text.numbers(chosen.demo))


def _last_row(text: Text, columns: Sequence[int]) -> int:
    """The number of rows up to the last that holds a position or a time; what follows is padding."""
    there = [any(not is_missing(row[i]) for i in columns) for row in text.cells]
    return max((i + 1 for i, full in enumerate(there) if full), default=len(there))


def _check(path: Path, text: Text, header: Sequence[str], columns: Sequence[int], last: int, bridged: bool) -> None:
    """Refuse cells that are no finite numbers; missing ones stay where they are to be bridged."""
    for row in range(last):
        for i in columns:
            cell = text.cells[row][i]
            if math.isfinite(float(cell)) if is_number(cell) else bridged and is_missing(cell):
                continue
            advice = "pass resample=True to bridge it" if is_missing(cell) else f"pass ignore={header[i]!r}"
            raise FileError(
                f"{path}, line {text.lines[row]}, column {header[i]!r}: {cell.strip()!r} is not a finite number; correct the "
                f"line or remove it, or {advice} (values are separated by {text.form})"
            )


def _clock(
    path: Path, text: Text, columns: Sequence[Named], numbers: Sequence[int], how: Reading, last: int
) -> np.ndarray:
    """The times [s] of the rows, of one column or of one with whole seconds and one with the rest in ns."""
    unit = how.get("time_unit")
    if len(numbers) == 2:
        whole, rest = (text.whole(i) for i in numbers)
        if whole is not None and rest is not None and unit is None:
            both = [None if a is None or b is None else a * 10**9 + b for a, b in zip(whole, rest, strict=True)]
            return seconds(str(path), np.array(both, dtype=object), "ns")
        return text.numbers(numbers[0]) + 1e-9 * text.numbers(numbers[1])
    stamps = text.whole(numbers[0])
    if unit is None:
        unit = time_unit(columns[numbers[0]])
        if unit is None and (unknown := columns[numbers[0]].unit):
            raise FileError(
                f"{path}: the unit of the column {columns[numbers[0]].name!r} is {unknown!r}; pass time_unit= one of "
                f"{', '.join(map(repr, UNITS))}"
            )
    values = text.numbers(numbers[0]) if stamps is None else stamps
    return seconds(f"{path}: column {columns[numbers[0]].name!r}", values, unit, whole=stamps is not None)


def read_table(path: str | Path) -> tuple[list[str], np.ndarray]:
    """The header and the `(T, columns)` numbers of a table.

    Raises:
        FileError: there is no such file, it is not a table of at least two rows of finite numbers under a header
            of different names; the message gives the line.
    """
    path = existing(path)
    text = read_text(path)
    header = names_of(path, text, {})
    _check(path, text, header, range(len(header)), len(text.cells), False)
    return header, np.stack([text.numbers(i) for i in range(len(header))], -1)


def _csv_files(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    if not isinstance(paths, (str, Path)):
        files = [existing(path) for path in paths]
        if not files:
            raise InvalidArgumentError("paths has to be a .csv file, a folder of them, or several files, got none")
        return files
    if not Path(paths).is_dir():
        return [existing(paths)]
    files = sorted(path for path in Path(paths).iterdir() if path.suffix.lower() == ".csv")
    if not files:
        raise FileError(f"{paths}: no .csv file in this folder")
    return files
