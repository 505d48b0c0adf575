"""What `tell` asks about recordings before it believes them: whether each is the motion that its reference asked for.

A soft arm deviates from its reference by decimetres, so that no distance alone says that a recording is wrong. What
is looked for is another motion that explains the recording much better: standing still, a mirrored or turned frame, another
speed, the reference of another roll-out.

Letters: `N` roll-outs, `T` control steps, `C` positions, `q` measured and `u` asked motion from their first points on, in the
unit of the first position (`Layout.lever`: an angle counts as the way of a point 0.2 m away, say).

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchds.sessions.layout import Layout
from torchds.sessions.tables import clock_jump, recorded_columns, recording

STILL = 0.1
"""Share of the reference's size below which a robot has not moved."""
BETTER = 0.5
"""Another motion explains a recording if it leaves at most this share of the deviation."""
EXCHANGED = 0.72
"""Recordings are in a wrong order if another one leaves at most this share. In simulation, at 75 to 700 N/m and with both
explorations, a true exchange leaves 0.08 to 0.69, and the best other order of what was in order 0.91 and more; 0.745 where arms
bend by as much as the references differ."""
TURNED = 30.0
"""Degrees by which a frame has to be turned: what an arm as soft as 8 cm makes of a motion can look like 22°."""
LARGE = 0.25
"""Deviations below this share of the reference's size are not questioned."""
ELSEWHERE = 1.5
"""Share of the reference's size above which a recording is another motion, whatever it is."""
SPEEDS = np.r_[np.geomspace(1 / 3, 1 / 1.2, 12), np.geomspace(1.2, 3, 12)]
DELAYS = np.linspace(0.05, 0.5, 10)
"""Shares of the motion by which a recording may be late."""


class Finding(NamedTuple):
    """Something about recordings that should not be so.

    Attributes:
        name: of the kind: still, mirrored, turned, speed, late, swapped, copied, elsewhere, force, sign, or clock.
        rollouts: numbers of the recordings.
        gross: whether they are refused for it.
        words: what was found, and what it may be.
    """

    name: str
    rollouts: tuple[int, ...]
    gross: bool
    words: str

    def __str__(self) -> str:
        files = " and ".join(f"recording-{k}.csv" for k in self.rollouts)
        return f"{files}: {self.words}"


def question(layout: Layout, numbers: Sequence[int], measured: Tensor, asked: Tensor, dt: float) -> list[Finding]:
    """What is to be said about the recordings of an update.

    Args:
        layout: of the columns.
        numbers: `[N]` of the roll-outs that were recorded.
        measured: `(N, T+1, C)` positions.
        asked: `(N, T+1, C)` those of the references.
        dt: time step [s].
    """
    lever = torch.tensor(layout.lever, dtype=measured.dtype)
    q, u = (((x - x[:, :1]) * lever).numpy() for x in (measured, asked))
    found = [*copies(numbers, measured.numpy(), asked.numpy()), *swaps(numbers, q, u)]
    named = {k for finding in found for k in finding.rollouts}
    for i, k in enumerate(numbers):
        if k not in named:
            found += [Finding(name, (k,), gross, words) for name, gross, words in motion(layout, q[i], u[i], dt)]
    return found


def clocks(layout: Layout, numbers: Sequence[int], folder: Path) -> Iterator[Finding]:
    """Recordings whose clock jumps."""
    for k in numbers:
        if words := clock_jump(*recorded_columns(layout, recording(folder, k))[:2], layout.lever):
            yield Finding("clock", (k,), True, words)


def rms(x: np.ndarray) -> float:
    """Root of the mean squared norm of `(T, D)`."""
    return float(np.sqrt(np.square(x).sum(-1).mean()))


def motion(layout: Layout, q: np.ndarray, u: np.ndarray, dt: float) -> Iterator[tuple[str, bool, str]]:
    """What a measured motion `(T+1, C)` is, if not the one that was asked for."""
    unit = layout.units[0]
    size, deviation = rms(u), rms(q - u)
    if size < 1e-6 or deviation < LARGE * size:
        return
    if rms(q) < STILL * size:
        yield "still", True, f"the robot hardly moved, {rms(q):.2g} {unit} where its reference moves {size:.2g} {unit}"
        return
    name, words, left = min(others(layout, q, u, dt), key=lambda other: other[2])
    if left < BETTER * deviation:
        yield name, True, f"{words}: that explains all but {left:.2g} {unit} of a deviation of {deviation:.2g} {unit}"
    elif deviation > ELSEWHERE * size:
        yield (
            "elsewhere",
            True,
            f"deviates by {deviation:.2g} {unit} on average from a reference that moves {size:.2g} {unit}",
        )


def others(layout: Layout, q: np.ndarray, u: np.ndarray, dt: float) -> Iterator[tuple[str, str, float]]:
    """Other motions that a recording may be, with what they leave of it."""
    names, n = [name.partition(" [")[0] for name in layout.position], u.shape[1]
    for axis, name in enumerate(names):
        sign = np.ones(n)
        sign[axis] = -1
        yield "mirrored", f"{name} is mirrored", rms(q - u * sign)
    for i, j in combinations(range(n), 2):
        if layout.units[i] != layout.units[j]:
            continue
        order = np.arange(n)
        order[[i, j]] = j, i
        yield "turned", f"{names[i]} and {names[j]} are swapped", rms(q - u[:, order])
        a, b = q[:, i] + 1j * q[:, j], u[:, i] + 1j * u[:, j]
        angle = float(np.angle((a * b.conj()).sum()))
        if abs(angle) > np.radians(TURNED):
            turn, turned = b * np.exp(1j * angle), u.copy()
            turned[:, i], turned[:, j] = turn.real, turn.imag
            yield "turned", f"the frame is turned by {np.degrees(angle):.0f}°", rms(q - turned)
    t = np.arange(len(u), dtype=float)
    for speed in SPEEDS:
        yield "speed", f"executed at {speed:.2g} times the speed", rms(q - at(u, speed * t))
    for share in DELAYS:
        late = share * t[-1]
        yield "late", f"executed {late * dt:.2g} s late", rms(q - at(u, t - late))


def at(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The motion `(T+1, C)` at other steps; held before its start and after its end."""
    return np.column_stack([np.interp(t, np.arange(len(u)), column) for column in u.T])


def copies(numbers: Sequence[int], pose: np.ndarray, asked: np.ndarray) -> Iterator[Finding]:
    """Recordings that hold the same measurements for different references."""
    for i, k in enumerate(numbers):
        for j in range(i):
            if np.abs(pose[i] - pose[j]).max() < 1e-9 and np.abs(asked[i] - asked[j]).max() > 1e-6:
                yield Finding("copied", (numbers[j], k), True, "hold the same measurements: one is a copy")


def swaps(numbers: Sequence[int], q: np.ndarray, u: np.ndarray) -> list[Finding]:
    """Recordings that fit the references of others better than their own, but for what all recordings deviate alike."""
    from scipy.optimize import linear_sum_assignment

    q = q - (np.median(q, 0) - np.median(u, 0))  # the same in whatever order they are
    distance = np.sqrt(np.square(q[:, None] - u[None]).sum(-1).mean(-1))
    rows, columns = linear_sum_assignment(distance)
    moved = rows[rows != columns]
    if not len(moved) or distance[moved, columns[moved]].sum() > EXCHANGED * distance[moved, moved].sum():
        return []
    pairs = ", ".join(f"recording-{numbers[i]} is the motion of rollout-{numbers[columns[i]]}.csv" for i in moved)
    return [Finding("swapped", tuple(numbers[i] for i in moved), True, f"in a wrong order: {pairs}")]
