"""What all files of demonstrations have in common: names of fields, clocks, and the way into `Demonstrations`.

Stability: experimental.
"""

from __future__ import annotations

import functools
import math
import operator
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchds.arrays import per_demonstration
from torchds.demonstrations import Demonstrations
from torchds.errors import DemonstrationWarning, FileError, InvalidDemonstrationsError
from torchds.recordings.clock import even_step
from torchds.recordings.parts import Record, fitted_step, rows, without_padding
from torchds.recordings.reading import Reading

ALIASES = {
    "x": ("positions", "position", "pos", "x"),
    "v": ("velocities", "velocity", "vel", "v"),
    "stiffness": ("stiffness", "s"),
    "t": ("time", "t"),
    "dt": ("dt",),
}


def group(keys: Iterable[str]) -> list[dict[str, str]]:
    """Keys of arrays per demonstration, {"x": "demo0_x", "v": "demo0_v"}, ...; [] if there are none."""
    keys = list(keys)
    field = "|".join(alias for aliases in ALIASES.values() for alias in aliases)
    for pattern in (
        rf"demo(?P<i>\d+)_(?P<field>{field})",
        rf"(?P<field>{field})_?(?P<i>\d+)",
        rf"(?P<i>)(?P<field>{field})",
    ):
        groups: dict[int, dict[str, str]] = {}
        for key in keys:
            if match := re.fullmatch(pattern, key, re.IGNORECASE):
                groups.setdefault(int(match["i"] or 0), {})[match["field"].lower()] = key
        if any(alias in group for group in groups.values() for alias in ALIASES["x"]):
            return [groups[i] for i in sorted(groups)]
    return []


def canonical(record: Mapping[str, np.ndarray]) -> Record:
    """The fields of a record under the names x, v, stiffness, t, dt; others are dropped."""
    lowered = {key.lower(): value for key, value in record.items()}
    found = {field: [a for a in aliases if a in lowered] for field, aliases in ALIASES.items()}
    return {field: lowered[aliases[0]] for field, aliases in found.items() if aliases}


class Recorded(NamedTuple):
    """What a file of arrays holds.

    Attributes:
        path: of the file.
        records: one for each demonstration, with times in seconds.
        shared: a time step for the whole file.
        names: of the dimensions.
        units: of the positions.
    """

    path: Path
    records: list[Record]
    shared: np.ndarray | None
    names: list[str] | None = None
    units: list[str] | None = None

    def demonstrations(self, how: Reading) -> Demonstrations:
        """As demonstrations; nothing is said about them yet."""
        return from_records(self.path, self.records, how, shared=self.shared, names=self.names, units=self.units)


def together(files: Sequence[Recorded], how: Reading) -> Demonstrations:
    """The demonstrations of several files one after the other; what is suspicious about them is said as warnings.

    A `dt` of the arguments is one for all demonstrations of all files, or one for each of them.
    """
    ends = [0, *accumulate(len(file.records) for file in files)]
    steps = one_for_each(how.get("dt"), ends[-1])
    each = []
    for file, start, end in zip(files, ends, ends[1:], strict=False):
        own: Reading = {**how, "dt": steps[start:end]}
        each.append(file.demonstrations(own))
    demos = functools.reduce(operator.add, each)
    demos.check().warn(stacklevel=4)
    return demos


def from_records(
    source: Path,
    records: Sequence[Record],
    how: Reading,
    *,
    places: Sequence[str] | None = None,
    shared: np.ndarray | None = None,
    names: Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
) -> Demonstrations:
    """Demonstrations of records with times in seconds.

    Args:
        source: the file or folder.
        records: one for each demonstration.
        how: arguments of the reader.
        places: where each record stands, for messages.
        shared: a time step for the whole file.
        names: of the dimensions in the file.
        units: of the positions in the file.
    """
    n = len(records)
    where = [f"{source}: demonstration {i}" for i in range(n)] if places is None else places
    for field in ("x", "v", "stiffness"):
        missing = [i for i, record in enumerate(records) if field not in record]
        if missing and (field == "x" or len(missing) < n):
            what = {"x": "positions", "v": "velocities"}.get(field, field)
            raise FileError(f"{where[missing[0]]} has no {what}; give them in all demonstrations, or in none")
    for place, record in zip(where, records, strict=True):
        _check_arrays(place, record)
    given = one_for_each(how.get("dt"), n)
    common = [None] * n if shared is None else per_demonstration(f"{source}: dt", shared, n, FileError)
    names = how.get("names") if how.get("names") is not None else names
    units = how.get("units") if how.get("units") is not None else units
    cut = [without_padding(place, _without_last(record)) for place, record in zip(where, records, strict=True)]
    try:
        if how.get("resample"):
            demos = _resampled(where, cut, how, names, units)
        else:
            if how.get("duplicates") == "drop":
                cut = [_rising(place, record) for place, record in zip(where, cut, strict=True)]
            steps = [_time_step(*parts) for parts in zip(where, cut, common, given, strict=True)]
            demos = Demonstrations(
                [record["x"] for record in cut],
                [record["v"] for record in cut] if "v" in cut[0] else None,
                steps,
                stiffness=[record["stiffness"] for record in cut] if "stiffness" in cut[0] else None,
                names=names,
                units=units,
            )
    except InvalidDemonstrationsError as error:
        raise FileError(f"{source}: {' '.join(str(error).split())}") from error
    return demos


def one_for_each(dt: object, n: int) -> list[float | None]:
    """The argument dt as one for each of n demonstrations, None where it says nothing."""
    said = np.ravel(np.asarray(dt, dtype=object)).tolist()
    steps = per_demonstration("dt", [0.0 if step is None else step for step in said], n)
    return [None if said[i % len(said)] is None else step for i, step in enumerate(steps)]


def _check_arrays(where: str, record: Record) -> None:
    """Refuse arrays that are no numbers, and positions that are no matrix."""
    for field, what in (("x", "positions"), ("v", "velocities"), ("stiffness", "stiffness"), ("t", "time stamps")):
        if field in record and record[field].dtype.kind not in "fiub":
            raise FileError(f"{where}: {what} have to be real numbers, got {record[field].dtype}")
    if record["x"].ndim != 2 or 0 in record["x"].shape:
        raise FileError(
            f"{where}: positions have to be (T, D), samples in rows and dimensions in columns, got shape {record['x'].shape}"
        )


def _resampled(
    where: Sequence[str],
    records: Sequence[Record],
    how: Reading,
    names: Sequence[str] | None,
    units: str | Sequence[str] | None,
) -> Demonstrations:
    """The records at equal time steps; rows in which something is missing are left out before and bridged by the splines."""
    whole = []
    for place, record in zip(where, records, strict=True):
        if "t" not in record:
            raise FileError(
                f"{place} has no time to resample by; say which column it is, time=, or leave out resample="
            )
        n = len(record["x"])
        if wrong := [key for key in ("v", "stiffness", "t") if key in record and np.shape(record[key])[:1] != (n,)]:
            raise FileError(
                f"{place}: {wrong[0]} has to have the {n} rows of x, got shape {np.shape(record[wrong[0]])}"
            )
        fields = [record[key].reshape(n, -1) for key in ("x", "v", "stiffness", "t") if key in record]
        there = np.logical_and.reduce([np.isfinite(field.astype(float)).all(-1) for field in fields])
        if not there.all():
            _say(f"{place}: {int((~there).sum())} row(s) in which something is missing are bridged")
        whole.append(rows(record, there))
    step = how.get("resample")
    return Demonstrations.from_samples(
        [record["t"] for record in whole],
        [record["x"] for record in whole],
        [record["v"] for record in whole] if "v" in whole[0] else None,
        stiffness=[record["stiffness"] for record in whole] if "stiffness" in whole[0] else None,
        dt=None if isinstance(step, bool) else step,
        duplicates=how.get("duplicates", "refuse"),
        names=names,
        units=units,
    )


def _rising(where: str, record: Record) -> Record:
    """The record without samples whose time is not after all earlier ones."""
    if "t" not in record or record["t"].shape != (len(record["x"]),):
        return record
    t = record["t"]
    keep = np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    if not keep.all():
        _say(f"{where}: {int((~keep).sum())} sample(s) whose time does not rise are dropped")
    return rows(record, keep)


def _without_last(record: Record) -> Record:
    """The record without its last sample where the velocities, being forward differences, lack it."""
    n = len(np.atleast_1d(record["x"]))
    if "v" not in record or len(np.atleast_1d(record["v"])) != n - 1:
        return record
    return {
        key: value[:-1] if key not in ("v", "dt") and value.ndim and len(value) == n else value
        for key, value in record.items()
    }


def _time_step(where: str, record: Record, common: float | None, given: float | None) -> float:
    """The time step of a record: its own, else the file's, else the one given; those that are there must agree."""
    found = {}
    if "dt" in record:
        (found["dt"],) = per_demonstration(f"{where}: dt", record["dt"], 1, FileError)
    if "t" in record:
        found["its time stamps"] = even_step(where, np.ravel(record["t"]), len(np.atleast_1d(record["x"])))
    if not found and common is not None:
        found["the file's dt"] = common
    if given is not None:
        found["the argument dt"] = given
    if not found:
        raise FileError(f"{where} has no time step; pass dt= in seconds{_suggested(record)}")
    (first, step), *others = found.items()
    for name, other in others:
        if not math.isclose(step, other, rel_tol=1e-3):
            raise FileError(
                f"{where}: {first} says {step:.6g} s but {name} {other:.6g} s; keep one (retime() changes speed), for several "
                "demonstrations with dt= one for each, None where it has a clock"
            )
    return step


def _suggested(record: Record) -> str:
    """The time step under which the velocities would be the derivative of the positions, in words."""
    x, v = record["x"], record.get("v")
    numbers = v is not None and x.ndim == 2 and v.shape == x.shape and x.dtype.kind == v.dtype.kind == "f"
    step = fitted_step(x, v) if v is not None and numbers else None
    return "" if step is None else f"; its velocities fit dt={step:.3g}"


def _say(text: str) -> None:
    warnings.warn(text, DemonstrationWarning, stacklevel=2)
