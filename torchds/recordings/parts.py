"""One record or several: where a new demonstration begins, and where a record ends and padding begins.

Stability: experimental.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence

import numpy as np
import torch

from torchds import findings
from torchds.errors import DemonstrationWarning, FileError
from torchds.recordings.reading import Reading

Record = dict[str, np.ndarray]  # what one demonstration has of x, v, stiffness (T, .), t (T,) [s] and dt () [s]
ALIKE = 0.1  # relative error of velocities that are the derivative of positions
GAP = 10.0  # usual time steps, from which on `split=True` begins a new demonstration


def rows(record: Record, chosen: np.ndarray | slice) -> Record:
    """The record with some of its samples."""
    n = len(record["x"])
    return {key: a[chosen] if key != "dt" and a.ndim and len(a) == n else a for key, a in record.items()}


def by_number(where: str, record: Record, numbers: np.ndarray) -> list[Record]:
    """One record for each value of a column that numbers demonstrations, in the order in which they first stand."""
    if not np.isfinite(numbers).all():
        row = int(np.flatnonzero(~np.isfinite(numbers))[0])
        raise FileError(
            f"{where}, row {row} (counted from 0): no number of a demonstration; fill it in or remove the row"
        )
    values, first = np.unique(numbers, return_index=True)
    return [rows(record, numbers == value) for value in values[np.argsort(first)]]


def split(where: str, record: Record, how: Reading, breaks: Sequence[int] = ()) -> list[Record]:
    """The demonstrations in one record.

    A new one begins where time starts anew; without time, where blank lines stand; with split=True also at jumps and gaps.

    Args:
        where: the file, for messages.
        record: in one piece.
        how: arguments of the reader.
        breaks: rows in front of which blank lines stand.

    Raises:
        FileError: a part has a single sample.
    """
    asked = how.get("split")
    if asked is False or "x" not in record or record["x"].ndim != 2 or len(record["x"]) < 2:
        return [record]
    n, t = len(record["x"]), record.get("t")
    starts = set(breaks) if t is None or asked is True else set()
    if t is not None and t.shape == (n,):
        starts |= set(_anew(t))
    if asked is True:
        if np.isfinite(record["x"]).all():
            starts |= {row + 1 for row in findings.jumps(torch.from_numpy(record["x"].astype(float)))}
        if t is not None and t.shape == (n,):
            steps = np.abs(np.diff(t))
            starts |= set((np.flatnonzero(steps > GAP * np.median(steps)) + 1).tolist())
    bounds = [0, *sorted(starts), n]
    for a, b in itertools.pairwise(bounds):
        if b - a < 2:
            raise FileError(
                f"{where}, row {a} (counted from 0): a demonstration of one sample begins there; remove the row, or pass "
                "split=False to read on"
            )
    if asked is None and starts:
        why = "time starts anew" if t is not None else "blank lines stand"
        _say(
            f"{where}: {len(bounds) - 1} demonstrations, since {why} at rows {sorted(starts)[:5]}; split=False reads on"
        )
    return [rows(record, slice(a, b)) for a, b in itertools.pairwise(bounds)]


def _anew(t: np.ndarray) -> list[int]:
    """The rows at which time goes back to about where it began."""
    found, start = [], 0
    for row in np.flatnonzero(np.diff(t) < 0).tolist():
        if t[row] > t[start] and t[row + 1] <= t[start] + 0.1 * (t[row] - t[start]):
            found.append(row + 1)
            start = row + 1
    return found


def without_padding(where: str, record: Record) -> Record:
    """The record without what fills it up to a common length: NaN, or zeros behind a jump to zero."""
    x = record["x"]
    if x.ndim != 2 or x.dtype.kind not in "fiu" or not len(x):
        return record
    full = np.flatnonzero(~np.isnan(x).all(-1))
    end = int(full[-1]) + 1 if len(full) else 0
    if 0 < end < len(x):
        _say(f"{where}: the last {len(x) - end} of {len(x)} rows hold no positions and are taken as padding")
        record = rows(record, slice(0, end))
        x = record["x"]
    moved = np.flatnonzero((x != 0).any(-1))
    end = int(moved[-1]) + 1 if len(moved) else 0
    if 4 < end < len(x) - 1 and np.isfinite(x).all():
        steps = np.linalg.norm(np.diff(x[:end], axis=0), axis=-1)
        if np.linalg.norm(x[end - 1]) > findings.JUMP * max(steps[-1], _usual(steps)):
            _say(f"{where}: the last {len(x) - end} of {len(x)} rows are zero behind a jump and are taken as padding")
            record = rows(record, slice(0, end))
    return record


def fitted_step(x: np.ndarray, v: np.ndarray) -> float | None:
    """The time step with which velocities `v` are the derivative of `x`, both `(T, D)`, away from jumps; None if none is."""
    there = np.isfinite(x).all(-1) & np.isfinite(v).all(-1)
    x, v = x[there].astype(float), v[there][1:-1].astype(float)
    if len(x) < 8:
        return None
    change = (x[2:] - x[:-2]) / 2
    lengths = np.linalg.norm(np.diff(x, axis=0), axis=-1)
    jump = lengths > findings.JUMP * _usual(lengths)  # several demonstrations in one
    change, v = change[~(jump[1:] | jump[:-1])], v[~(jump[1:] | jump[:-1])]
    size = float((v * v).sum())
    step = float((change * v).sum()) / size if 0 < size < np.inf else 0.0
    alike = step > 0 and np.linalg.norm(change - step * v) < ALIKE * np.linalg.norm(change)
    return step if alike else None


def _usual(steps: np.ndarray) -> float:
    """The upper quartile of the steps that move."""
    moving = steps[steps > 0]
    return float(np.quantile(moving, 0.75)) if len(moving) else 0.0


def _say(text: str) -> None:
    warnings.warn(text, DemonstrationWarning, stacklevel=2)
