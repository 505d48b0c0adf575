"""What all files of demonstrations have in common: names of fields, time steps, and the way into `Demonstrations`.

Stability: experimental.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from torchds.arrays import per_demonstration
from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, InvalidDemonstrationsError

Record = Mapping[str, np.ndarray]  # what one demonstration has of x, v, stiffness (T, .), t (T,) [s] and dt () [s]

ALIASES = {
    "x": ("positions", "position", "pos", "x"),
    "v": ("velocities", "velocity", "vel", "v"),
    "stiffness": ("stiffness", "s"),
    "t": ("time", "t"),
    "dt": ("dt",),
}


def existing(path: str | Path) -> Path:
    """The path of a file that is there.

    Raises:
        FileError: there is none.
    """
    path = Path(path)
    if not path.is_file():
        raise FileError(f"{path}: no such file (looked in {path.resolve().parent})")
    return path


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


def canonical(record: Record) -> Record:
    """The fields of a record under the names x, v, stiffness, t, dt; others are dropped."""
    lowered = {key.lower(): value for key, value in record.items()}
    found = {field: [a for a in aliases if a in lowered] for field, aliases in ALIASES.items()}
    return {field: lowered[aliases[0]] for field, aliases in found.items() if aliases}


def from_records(
    source: Path | Sequence[Path],
    records: Sequence[Record],
    *,
    shared: np.ndarray | None = None,
    dt: float | Sequence[float] | None,
    names: Sequence[str] | None,
    units: str | Sequence[str] | None,
) -> Demonstrations:
    """Demonstrations of records from one file, or from one file each; `shared` is a time step for the whole file."""
    n = len(records)

    def where(i: int) -> str:
        return f"{source}: demonstration {i}" if isinstance(source, Path) else str(source[i])

    for field in ("x", "v", "stiffness"):
        missing = [i for i, record in enumerate(records) if field not in record]
        if missing and (field == "x" or len(missing) < n):
            what = {"x": "positions", "v": "velocities"}.get(field, field)
            raise FileError(f"{where(missing[0])} has no {what}; give them in all demonstrations, or in none")
    given = [None] * n if dt is None else per_demonstration("dt", dt, n)
    common = [None] * n if shared is None else per_demonstration(f"{source}: dt", shared, n, FileError)
    steps = [_time_step(where(i), record, common[i], given[i]) for i, record in enumerate(records)]
    cut = [_without_last(record) for record in records]
    try:
        return Demonstrations(
            [record["x"] for record in cut],
            [record["v"] for record in cut] if "v" in cut[0] else None,
            steps,
            stiffness=[record["stiffness"] for record in cut] if "stiffness" in cut[0] else None,
            names=names,
            units=units,
        )
    except InvalidDemonstrationsError as error:
        files = source if isinstance(source, Path) else ", ".join(map(str, source))
        raise FileError(f"{files}: {error}") from error


def _without_last(record: Record) -> Record:
    """The record without its last sample where the velocities, being forward differences, lack it."""
    n = len(np.atleast_1d(record["x"]))
    if "v" not in record or len(np.atleast_1d(record["v"])) != n - 1:
        return record
    return {
        key: value[:-1] if key != "v" and value.ndim == 2 and len(value) == n else value
        for key, value in record.items()
    }


def _time_step(where: str, record: Record, common: float | None, given: float | None) -> float:
    """The time step of a record: its own, else the file's, else the one given; those that are there must agree."""
    found = {}
    if "dt" in record:
        (found["dt"],) = per_demonstration(f"{where}: dt", record["dt"], 1, FileError)
    if "t" in record:
        found["its time stamps"] = _uniform_step(
            where, np.ravel(record["t"]).astype(float), len(np.atleast_1d(record["x"]))
        )
    if not found and common is not None:
        found["the file's dt"] = common
    if given is not None:
        found["the argument dt"] = given
    if not found:
        raise FileError(f"{where} has no time step; pass dt= in seconds")
    (first, step), *others = found.items()
    for name, other in others:
        if not math.isclose(step, other, rel_tol=1e-3):
            raise FileError(
                f"{where}: {first} says {step:.6g} s but {name} {other:.6g} s; keep one (retime() changes speed)"
            )
    return step


def _uniform_step(where: str, t: np.ndarray, n_samples: int) -> float:
    """The time step of time stamps (T,) that are equally spaced."""
    if len(t) != n_samples:
        raise FileError(f"{where}: time stamps have to be one for each of the {n_samples} positions, got {len(t)}")
    if len(t) < 2:
        raise FileError(f"{where} has to have at least two samples, got {len(t)}; leave it out")
    steps = np.diff(t)
    usual = np.median(steps)
    bad = np.flatnonzero(~((np.abs(steps - usual) <= 1e-3 * usual) & (usual > 0)))
    if len(bad):
        row = int(bad[0])
        raise FileError(
            f"{where}: the time steps have to be equal: from row {row} to row {row + 1} (counted from 0) time goes from "
            f"{t[row]:.6g} to {t[row + 1]:.6g} s where {usual:.6g} s is usual; resample the recording to equal time "
            "steps, or remove its time and pass dt="
        )
    return float((t[-1] - t[0]) / (len(t) - 1))
