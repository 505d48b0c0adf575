"""Comma-separated files of demonstrations.

Stability: stable.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.recordings.base import Record, existing, from_records


def load_csv(
    paths: str | Path | Sequence[str | Path],
    *,
    dt: float | Sequence[float] | None = None,
    time_column: str | None = None,
    names: Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
) -> Demonstrations:
    """One demonstration per comma-separated file; the first line holds the names of the columns.

    A column `t` or `time` holds the time [s], `v_<name>` the velocity of the column <name>, columns that start with
    `s_` or `stiffness` the stiffness; all others are positions. All files have the same columns.

    Args:
        paths: a file, a folder whose *.csv are read in the order of their names, or a sequence of files.
        dt: time step [s], needed if there is no column of time; one for all or one per file.
        time_column: the column of time, if it has another name.
        names: the columns that are positions, in this order; further columns are then ignored.
        units: as for `Demonstrations`.

    Raises:
        FileError: a file is missing, is not a table of finite numbers under a header, or its time steps
            are not equal to one part in a thousand; the message gives the line.
        UnknownNameError: `time_column` or one of `names` is not a column.
    """
    files = _csv_files(paths)
    layout: _Columns | None = None
    records: list[Record] = []
    for path in files:
        header, table = read_table(path)
        if layout is None:
            first, layout = header, _columns(path, header, time_column, names)
        if set(header) != set(first):
            raise FileError(
                f"{path}: the columns are {', '.join(header)} but those of {files[0]} are {', '.join(first)}; "
                "give all files the same columns"
            )
        chosen = {
            field: table[:, [header.index(column) for column in columns]]
            for field, columns in layout._asdict().items()
            if columns
        }
        records.append(chosen)
    assert layout is not None
    return from_records(files, records, dt=dt, names=layout.x, units=units)


def read_table(path: str | Path) -> tuple[list[str], np.ndarray]:
    """The header and the `(T, columns)` numbers of a comma-separated file.

    Raises:
        FileError: there is no such file, it is not a table of at least two rows of finite numbers under a header
            of different names; the message gives the line.
    """
    path = existing(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, line) for line in reader if any(cell.strip() for cell in line)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{path}: not a text file of comma-separated values ({error})") from error
    header = [cell.strip() for cell in lines[0][1]] if lines else []
    if not any(_number(cell) is None for cell in header):
        raise FileError(f"{path}: no header; the first line has to hold the names of the columns")
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated or "" in header:
        problem = f"the name {repeated[0]!r} twice" if repeated and repeated[0] else "a column without a name"
        raise FileError(f"{path}: the header has {problem}; give every column its own name")
    if len(lines) < 3:
        raise FileError(f"{path}: at least two samples are needed, got {max(len(lines) - 1, 0)}; leave it out")
    rows = []
    for number, line in lines[1:]:
        if len(line) != len(header):
            raise FileError(
                f"{path}, line {number}: {len(line)} values under {len(header)} column names; fill or remove the line"
            )
        values = [_number(cell) for cell in line]
        for name, cell, value in zip(header, line, values, strict=True):
            if value is None or not math.isfinite(value):
                raise FileError(
                    f"{path}, line {number}, column {name!r}: {cell.strip()!r} is not a finite number; "
                    "correct the line or remove it (values are separated by commas)"
                )
        rows.append(values)
    return header, np.array(rows, dtype=float)


class _Columns(NamedTuple):
    x: list[str]
    v: list[str]
    stiffness: list[str]
    t: list[str]


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


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _columns(path: Path, header: list[str], time_column: str | None, names: Sequence[str] | None) -> _Columns:
    """Which columns of a .csv file are what."""
    for name in [*([] if time_column is None else [time_column]), *(names or [])]:
        if name not in header:
            raise UnknownNameError(f"column of {path.name}", name, header)
    times = [name for name in header if name.lower() in ("t", "time") and name not in (names or [])]
    times = times if time_column is None else [time_column]
    if len(times) > 1:
        raise FileError(f"{path}: the columns {' and '.join(times)} could be time; choose with time_column=")
    stiffness = [c for c in header if c.startswith(("s_", "stiffness")) and c not in [*times, *(names or [])]]
    x = list(names or [])
    if names is None:
        x = [name for name in header if name not in [*times, *stiffness] and not name.startswith("v_")]
    expected = [f"v_{name}" for name in x]
    v = [name for name in header if name.startswith("v_") and (names is None or name in expected)]
    if not x:
        raise FileError(f"{path}: none of the columns {', '.join(header)} is a position")
    if v and set(v) != set(expected):
        raise FileError(
            f"{path}: the velocities are {', '.join(v)} but the positions {', '.join(x)}; name the velocity of each "
            f"position, {', '.join(expected)}, or remove all velocities"
        )
    return _Columns(x, expected if v else [], stiffness, times)
