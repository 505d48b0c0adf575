"""Arrays of positions in files: which axis is time, which columns are what, and several demonstrations in one.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from torchds.errors import FileError, InvalidArgumentError
from torchds.recordings.clock import EVEN, seconds
from torchds.recordings.parts import ALIKE, Record, fitted_step, split
from torchds.recordings.reading import Reading, several


def apart(where: str, record: Record, how: Reading) -> list[Record]:
    """The records in one whose positions have three axes: demonstrations, samples and dimensions in some order.

    Raises:
        FileError: it cannot be told which axis is which.
    """
    x = record["x"]
    if x.ndim != 3:
        return [record]
    time, demo = how.get("time_axis"), how.get("demo_axis")
    longest = [axis for axis in range(3) if x.shape[axis] == max(x.shape)]
    if time is None and len(longest) == 1:
        (time,) = longest
    if demo is None and time is not None and x.dtype.kind == "f" and np.isnan(x).any():
        lengths = np.isnan(x).sum(time)
        by_axis = [axis for axis in range(3) if axis != time]
        same = [bool((lengths == lengths.take([0], axis)).all()) for axis in (0, 1)]
        if same[0] != same[1]:  # all dimensions of a demonstration end together
            demo = by_axis[0] if same[1] else by_axis[1]
    if time is None or demo is None or time == demo:
        shape = " x ".join(map(str, x.shape))
        first = time if time is not None else 1
        options = " or ".join(f"time_axis={first}, demo_axis={axis}" for axis in range(3) if axis != first)
        raise FileError(
            f"{where}: an array of {shape}: which axis counts demonstrations, which samples? Pass {options}, counted from 0"
        )
    if "v" in record and record["v"].shape != x.shape:
        raise FileError(f"{where}: the velocities have to have the shape {x.shape} of the positions")
    dims = 3 - time - demo
    order = (demo, time, dims)
    fields = {key: record[key].transpose(order) for key in ("x", "v") if key in record}
    rest = {key: value for key, value in record.items() if key not in fields}
    return [{key: value[i] for key, value in fields.items()} | rest for i in range(x.shape[demo])]


def upright(where: str, record: Record, how: Reading, *, longer: bool, dim: int | None = None) -> Record:
    """The record with time along the first axis of its arrays.

    Args:
        where: the file and demonstration, for messages.
        record: one demonstration.
        how: arguments of the reader.
        longer: whether the longer axis is time where nothing says otherwise.
        dim: number of dimensions, where the file says it.

    Raises:
        FileError: it cannot be told.
        InvalidArgumentError: an axis that matrices do not have.
    """
    shape = record["x"].shape
    if len(shape) != 2 or record["x"].dtype.kind not in "fiub":
        return record
    axis = how.get("time_axis") if how.get("demo_axis") is None else None
    if axis == 2:
        raise InvalidArgumentError(f"time_axis has to be 0 or 1 for a matrix, got 2 for one of {shape[0]} x {shape[1]}")
    stamps = record["t"].size if "t" in record else 0
    if axis is None and how.get("demo_axis") is not None:
        axis = 0  # brought into this order already
    if axis is None and dim in shape and shape[0] != shape[1]:
        axis = 1 - shape.index(dim)
    if axis is None and stamps in shape and shape[0] != shape[1]:
        axis = shape.index(stamps)
    if axis is None and shape[0] == shape[1]:
        if not longer:
            return record
        subject = where.replace("demonstration", "the positions of demonstration")
        raise FileError(
            f"{subject} are {shape[0]} x {shape[1]}: either axis could be time; pass time_axis=0 (samples are rows) or "
            "time_axis=1 (samples are columns)"
        )
    if axis is None and not longer:
        if shape[0] < shape[1]:
            raise FileError(
                f"{where}: {shape[0]} samples of {shape[1]} dimensions? Pass time_axis=1 if samples are columns, "
                "time_axis=0 if they are rows"
            )
        axis = 0
    if axis is None:
        axis = int(shape[1] > shape[0])
    return {key: value.T if axis == 1 and key not in ("t", "dt") else value for key, value in record.items()}


def chosen(where: str, record: Record, how: Reading) -> Record:
    """The record of a matrix whose columns the arguments tell apart by their numbers, without what is said to be none.

    Raises:
        FileError: a column that is not there, or a first column that rises evenly, as a clock does.
    """
    said = {field: several(how.get(name)) for field, name in FIELDS.items()}  # type: ignore[arg-type]
    columns = {field: names for field, names in said.items() if names and all(isinstance(c, int) for c in names)}
    record = {field: value for field, value in record.items() if said.get(field) != []}
    x, ignored = record["x"], [c for c in several(how.get("ignore")) or [] if isinstance(c, int)]
    if not (columns or ignored) or x.ndim != 2:
        return record
    used = [c for names in columns.values() for c in names] + ignored
    if strangers := [c for c in used if c not in range(x.shape[1])]:
        raise FileError(f"{where}: columns have to be 0 to {x.shape[1] - 1}, got {strangers}")
    if "x" not in columns:
        columns["x"] = [c for c in range(x.shape[1]) if c not in used]
    taken = {field: x[:, np.array(names, dtype=int)] for field, names in columns.items()}
    if "t" in taken:
        taken["t"] = taken["t"][:, 0]
    return {**record, **taken}


FIELDS: Mapping[str, str] = {"x": "positions", "v": "velocities", "stiffness": "stiffness", "t": "time"}


def with_halves(records: Sequence[Record], steps: Sequence[float | None], how: Reading) -> list[Record]:
    """The records, cut into positions and velocities where the second half of their columns is the derivative of the first.

    Args:
        records: of bare matrices.
        steps: time step [s] of each, where it is known.
        how: arguments of the reader; where it says what the columns are, nothing is changed.
    """
    said = any(how.get(name) is not None for name in ("positions", "velocities"))
    if said or any("v" in r or r["x"].ndim != 2 or r["x"].shape[1] % 2 for r in records):
        return list(records)
    if not all(_is_halves(record["x"], step) for record, step in zip(records, steps, strict=True)):
        return list(records)
    D = records[0]["x"].shape[1] // 2
    return [{**record, "x": record["x"][:, :D], "v": record["x"][:, D:]} for record in records]


def _is_halves(values: np.ndarray, step: float | None) -> bool:
    """Without a step, the one that fits best is taken: two motions are not derivatives of each other by chance."""
    D = values.shape[1] // 2
    fitted = fitted_step(values[:, :D], values[:, D:])
    return fitted is not None and (step is None or abs(fitted - step) <= ALIKE * step)


def without_clock(where: str, records: Sequence[Record], how: Reading) -> None:
    """Refuse bare matrices whose first column rises evenly, as a clock does, unless it is said what it is.

    Raises:
        FileError: with the call that says it.
    """
    if any(how.get(name) is not None for name in ("positions", "time", "velocities", "ignore")):
        return
    first = [
        r["x"][:, 0].astype(float) for r in records if r["x"].ndim == 2 and r["x"].shape[1] > 1 and len(r["x"]) > 4
    ]
    if len(first) == len(records) and all(_is_clock(column) for column in first):
        D = records[0]["x"].shape[1]
        raise FileError(
            f"{where}: the first of {D} columns rises evenly, as a clock does; pass time=0 if it is time, or "
            f"positions={tuple(range(D))!r} if it is a position"
        )


def _is_clock(column: np.ndarray) -> bool:
    steps = np.diff(column[np.isfinite(column)])
    return len(steps) > 3 and bool((steps > 0).all() and np.ptp(steps) <= EVEN * np.median(steps))


def finished(where: str, record: Record, how: Reading) -> list[Record]:
    """The demonstrations in one record, with time in seconds."""
    if "t" in record:
        stamps = np.ravel(record["t"])
        if stamps.dtype.kind not in "fiu":
            raise FileError(f"{where}: time stamps have to be numbers, got {stamps.dtype}")
        whole = stamps.dtype.kind in "iu"
        exact = np.array([int(s) for s in stamps], dtype=object) if whole else stamps
        record = {**record, "t": seconds(where, exact, how.get("time_unit"), whole=whole)}
    return split(where, record, how)


def place(path: Path, i: int) -> str:
    """Where a demonstration stands."""
    return f"{path}: demonstration {i}"


def names_said(how: Reading) -> dict[str, list[str]]:
    """The fields of files that the arguments name."""
    said = {field: several(how.get(name)) for field, name in FIELDS.items()}  # type: ignore[arg-type]
    return {field: names for field, names in said.items() if names and all(isinstance(c, str) for c in names)}  # type: ignore[misc]


def by_name(arrays: Mapping[str, np.ndarray], names: Mapping[str, Sequence[str]]) -> list[Record]:
    """The records of arrays that were named for each field: several vectors are the columns of one, else each is one."""
    named = {field: [arrays[name] for name in each] for field, each in names.items()}
    vectors = [np.ravel(values) for values in named.get("x", []) if values.size == max(values.shape, default=0)]
    if len(vectors) == len(named.get("x", [])) > 1 and len({len(values) for values in vectors}) == 1:
        columns = {
            field: np.stack([np.ravel(v) for v in values], -1) for field, values in named.items() if field != "t"
        }
        return [columns | ({"t": np.ravel(named["t"][0])} if "t" in named else {})]
    n = max(map(len, named.values()))
    return [{field: values[i] for field, values in named.items() if i < len(values)} for i in range(n)]
