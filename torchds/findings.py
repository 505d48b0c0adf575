"""What is suspicious about recorded motions: units, jumps, rests, goals, each with the call that mends it.

Every check compares a motion with itself or with the others of its set, so that no unit of length or time is assumed.
Letters: `T` samples, `D` dimensions.

Stability: experimental.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from torchds.errors import DemonstrationWarning

DISAGREEMENT = 0.5  # relative error of stored velocities from which on they are another quantity
EXPLAINED = 0.3  # relative error below which a unit, a sign or an order of axes explains them
JUMP = 8.0  # a step this many times as long as both of its neighbours and as a large usual step
STILL, RESTING = 2e-3, 0.1  # a rest: within this share of the extent, for this share of the samples
APART, CLOSED = 0.15, 0.02  # shares of the extent
SLOWEST, FASTEST = 1e-6, 1e3  # extents a second
MOST_PERMUTED = 4  # dimensions whose orders are all tried


class Recording(NamedTuple):
    """What a check sees of one demonstration.

    Attributes:
        x: `(T, D)` positions.
        v: `(T, D)` velocities as stored; None where they were derived from the positions.
        dt: time step [s].
    """

    x: Tensor
    v: Tensor | None
    dt: float


class Finding(NamedTuple):
    """One suspicion.

    Attributes:
        name: what kind of problem it is, in a word or two.
        demonstration: index of the demonstration, from 0; None where it is about all of them.
        row: of the sample, from 0; None where it is about the whole motion.
        value: the number that gave it away.
        message: what was seen and what it probably means.
        call: what to call to mend it.
    """

    name: str
    demonstration: int | None
    row: int | None
    value: float
    message: str
    call: str

    def __str__(self) -> str:
        """Place, message and call as one sentence."""
        place = "all demonstrations" if self.demonstration is None else f"demonstration {self.demonstration}"
        row = "" if self.row is None else f", row {self.row}"
        return f"{place}{row}: {self.message} [{self.name}]. Call {self.call}"


class Findings(tuple[Finding, ...]):
    """All suspicions about a set of demonstrations, empty where there are none; `print` shows one on each line."""

    def __str__(self) -> str:
        """One finding on each line."""
        return "\n".join(map(str, self)) or "nothing suspicious was found"

    def warn(self, stacklevel: int = 3) -> None:
        """Say each of them as a `DemonstrationWarning`."""
        for finding in self:
            warnings.warn(str(finding), DemonstrationWarning, stacklevel=stacklevel)


def find(recordings: Sequence[Recording], names: Sequence[str]) -> Findings:
    """Everything suspicious, in the order in which it is best mended.

    Args:
        recordings: of one dimension D.
        names: of the D dimensions.
    """
    found: list[Finding] = []
    for i, recording in enumerate(recordings):
        if unresolved := list(_offset(i, recording, names)):
            found += unresolved  # whatever else is seen there is the rounding of the numbers
            continue
        for check in (_few_samples, _jumps, _rests, _velocities, _speed, _closed):
            found += check(i, recording, names)
    found += _quaternion(recordings, names)
    found += _goals(recordings)
    return Findings(found)


def extent(x: Tensor) -> float:
    """The diagonal of the box around a motion `(T, D)`."""
    return float(torch.linalg.vector_norm(x.amax(0) - x.amin(0)))


def resting(x: Tensor) -> tuple[int, int]:
    """How many samples at the beginning and at the end of `x` `(T, D)` stay where the motion begins and ends."""
    near = STILL * extent(x)
    counts = []
    for ordered in (x, x.flip(0)):
        moved = torch.linalg.vector_norm(ordered - ordered[0], dim=-1) > near
        counts.append(int(moved.int().argmax()) if bool(moved.any()) else len(x))
    return counts[0], counts[1]


def jumps(x: Tensor) -> list[int]:
    """The rows of `x` `(T, D)` after which it goes on somewhere else."""
    steps = torch.linalg.vector_norm(x.diff(dim=0), dim=-1)
    moving = steps.nonzero().flatten()  # where a slow sensor repeats its last value, every other step would be a jump
    steps = steps[moving]
    if len(steps) < 4:
        return []
    usual = steps.quantile(0.75)
    before, after = F.pad(steps[:-1], (1, 0)), F.pad(steps[1:], (0, 1))
    around = torch.maximum(before, after)
    found: list[int] = moving[steps > JUMP * torch.maximum(around, usual)].tolist()
    return found


def turns(x: Tensor, row: int) -> list[tuple[int, float]]:
    """Columns of `x` that jump by one full turn after `row`, and that turn: 2π or 360."""
    step = (x[row + 1] - x[row]).abs()
    return [
        (column, turn)
        for column, size in enumerate(step.tolist())
        for turn in (2 * math.pi, 360.0)
        if abs(size - turn) < 0.1 * turn and float(x[:, column].abs().max()) < 1.05 * turn
    ]


# ------------------------------------------------------------------ checks of one motion


def _few_samples(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    T, D = recording.x.shape
    if T < D:
        yield Finding(
            "few samples",
            i,
            None,
            T,
            f"{T} samples of {D} dimensions: rows and columns may be exchanged",
            "x.T, or time_axis=1",
        )


def _jumps(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    for row in jumps(recording.x):
        length = float(torch.linalg.vector_norm(recording.x[row + 1] - recording.x[row]))
        if wrapped := turns(recording.x, row):
            columns = [column for column, _ in wrapped]
            what = f"{' and '.join(names[c] for c in columns)} jumps by a full turn, {wrapped[0][1]:.4g}"
            yield Finding("wrapped angle", i, row, length, what, f"unwrap({columns})")
        else:
            what = f"a jump of {length:.4g} to the next row, where steps are shorter: several demonstrations in one?"
            yield Finding("jump", i, row, length, what, "split()")


def _rests(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    T = len(recording.x)
    if extent(recording.x) == 0:
        yield Finding(
            "rest", i, None, T, f"it never moves: {T} samples of one place", "demos[1:], or a slice that leaves it out"
        )
    for where, count in zip(("beginning", "end"), resting(recording.x), strict=True):
        if count > max(RESTING * T, 4) and count < T:
            row = count - 1 if where == "beginning" else T - count
            yield Finding(
                "rest", i, row, count, f"it stays in place for {count} of {T} samples at the {where}", "trim_rests()"
            )


def _velocities(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    x, v = recording.x, recording.v
    if v is None or len(x) < 4 or jumps(x):
        return
    derivative = (x[2:] - x[:-2]) / (2 * recording.dt)
    stored = v[1:-1]
    size = torch.linalg.vector_norm(derivative)
    if size == 0 or torch.linalg.vector_norm(stored - derivative) <= DISAGREEMENT * size:
        return
    factor, error = _explained(stored, derivative)
    if error < EXPLAINED and factor < 0:
        others = "" if abs(factor + 1) < 0.1 else f" and {-factor:.4g} times as large"
        what = f"the stored velocities point against the motion{others}"
        yield Finding("velocity sign", i, None, factor, what, "differentiate()")
    elif error < EXPLAINED:
        what = f"the stored velocities are {factor:.4g} times the derivative of the positions: another unit of time or length?"
        yield Finding("velocity unit", i, None, factor, what, "differentiate()")
    elif (order := _order(stored, derivative)) is not None:
        columns = ", ".join(names[column] for column in order)
        what = f"the stored velocities are those of the columns {columns}, in this order: axes are exchanged"
        yield Finding("velocity axes", i, None, error, what, "differentiate()")
    else:
        what = f"the stored velocities differ from the derivative of the positions by {100 * error:.0f} %"
        yield Finding("velocity", i, None, error, what, "differentiate()")


def _explained(stored: Tensor, derivative: Tensor) -> tuple[float, float]:
    """The factor c that makes c times the derivative most like the stored velocities, and the relative error that is left."""
    factor = (stored * derivative).sum() / derivative.square().sum()
    size = torch.linalg.vector_norm(stored).clamp_min(torch.finfo(stored.dtype).tiny)
    return float(factor), float(torch.linalg.vector_norm(stored - factor * derivative) / size)


def _order(stored: Tensor, derivative: Tensor) -> tuple[int, ...] | None:
    """The order of the derivative's columns in which it explains the stored velocities."""
    D = stored.shape[-1]
    if D > MOST_PERMUTED:
        return None
    orders = [order for order in itertools.permutations(range(D)) if order != tuple(range(D))]
    errors = [_explained(stored, derivative[:, list(order)]) for order in orders]
    fitting = [(error, order) for (factor, error), order in zip(errors, orders, strict=True) if factor > 0]
    error, order = min(fitting, default=(math.inf, None))
    return order if error < EXPLAINED else None


def _speed(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    x, size = recording.x, extent(recording.x)
    if size == 0:
        return
    speed = float(torch.linalg.vector_norm(x.diff(dim=0), dim=-1).mean()) / recording.dt / size
    if not SLOWEST <= speed <= FASTEST:
        what = f"it covers {speed:.3g} times its own extent in a second, with a time step of {recording.dt:.6g} s: which unit?"
        yield Finding("time unit", i, None, speed, what, "retime(duration), or load with time_unit=")


def _offset(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    x, size = recording.x, extent(recording.x)
    away = float(torch.linalg.vector_norm(x.mean(0)))
    if 0 < size < 1e4 * torch.finfo(x.dtype).eps * away:
        what = (
            f"an extent of {size:.3g} at a distance of {away:.3g} from the origin: {x.dtype} hardly resolves the motion"
        )
        yield Finding("offset", i, None, size / away, what, "shift_to_goal()")


def _closed(i: int, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
    x, size = recording.x, extent(recording.x)
    gap = float(torch.linalg.vector_norm(x[-1] - x[0]))
    if size > 0 and len(x) > 3 and gap < CLOSED * size:
        what = f"it ends where it begins ({gap:.3g} apart): a motion that ends at its goal cannot leave it first"
        row = int(torch.linalg.vector_norm(x - x[0], dim=-1).argmax())
        yield Finding("closed curve", i, row, gap / size, what, f"split([{row}])")


# ------------------------------------------------------------------ checks of all of them


def _quaternion(recordings: Sequence[Recording], names: Sequence[str]) -> Iterator[Finding]:
    D = recordings[0].x.shape[-1]
    for first in range(D - 3):
        parts = [recording.x[:, first : first + 4] for recording in recordings]
        error = max(float((torch.linalg.vector_norm(part, dim=-1) - 1).abs().max()) for part in parts)
        if error < 1e-3 and any(extent(part) > 1e-6 for part in parts):
            columns = ", ".join(names[first : first + 4])
            what = f"the columns {columns} are a unit quaternion, which no linear system keeps on its sphere"
            yield Finding(
                "unit quaternion",
                None,
                None,
                error,
                what,
                f"torchds.poses.from_poses(position, [d.x[:, {first}:{first + 4}] for d in demos], dt=demos.dt), with "
                "order='xyzw' where the scalar stands last; or load(..., positions=) without them",
            )
            return


def _goals(recordings: Sequence[Recording]) -> Iterator[Finding]:
    ends = torch.stack([recording.x[-1] for recording in recordings])
    size = max(extent(recording.x) for recording in recordings)
    apart = float(torch.linalg.vector_norm(ends - ends.mean(0), dim=-1).max())
    if size > 0 and apart > APART * size:
        what = f"they end up to {apart:.3g} from their mean end, {100 * apart / size:.0f} % of the motion: one goal?"
        yield Finding("goals apart", None, None, apart / size, what, "shift_to_goal()")
