"""Mending recorded motions: uneven clocks, rests, wrapped angles, several motions in one, and what is suspicious.

Stability: stable.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from torchds import findings
from torchds.arrays import Array, check_positive, count, tensor, tensors
from torchds.errors import DemonstrationWarning, InvalidArgumentError, InvalidDemonstrationsError
from torchds.preparation import Demonstration, Preparation, gradient

Duplicates = Literal["refuse", "drop"]
Interpolation = Literal["cubic", "linear"]
MOST_SAMPLES = 1_000_000  # of one demonstration; more is a mistaken time step
GAP = 3.0  # usual time steps, from which on missing samples are spoken of


class Mending(Preparation):
    """The part of `Demonstrations` that finds and mends faults of recordings; what stands here is reached through them."""

    __slots__ = ()

    @classmethod
    def from_samples(
        cls,
        times: Sequence[Array],
        positions: Sequence[Array],
        velocities: Sequence[Array] | None = None,
        *,
        stiffness: Sequence[Array] | None = None,
        dt: float | None = None,
        n_samples: int | None = None,
        kind: Interpolation = "cubic",
        duplicates: Duplicates = "refuse",
        names: Sequence[str] | None = None,
        units: str | Sequence[str] | None = None,
    ) -> Self:
        """Demonstrations from samples at uneven times: splines through them, read off at equal time steps.

        What was resampled to what is said as a `DemonstrationWarning`, and gaps of several time steps in it, unless
        `n_samples` says what is wanted.

        Args:
            times: `(T,)` [s] of each demonstration, rising.
            positions: `(T, D)` of each.
            velocities: `(T, D)` of each [position unit/s]; None for the derivatives of cubic splines, or for the differences
                of what lines between the samples give.
            stiffness: `(T, Q)` of each [N/m], interpolated linearly; None without.
            dt: time step of the result [s], up to what makes first and last sample stay; None for the median of each
                demonstration's own.
            n_samples: of each demonstration of the result, in place of `dt`.
            kind: "cubic" splines, or "linear" for lines from sample to sample, which never swing beyond them.
            duplicates: what becomes of samples whose time is that of the one before: "refuse" them, or "drop" them.
            names: one for each dimension.
            units: of the positions, one for all dimensions or one for each.

        Raises:
            InvalidDemonstrationsError: times that do not rise, of another number than positions, or fewer samples than a
                spline needs: four, or two for lines.
            InvalidArgumentError: `dt`, `n_samples`, `kind` or `duplicates` is not allowed.
        """
        if kind not in ("cubic", "linear"):
            raise InvalidArgumentError(f"kind has to be 'cubic' or 'linear', got {kind!r}")
        if n_samples is not None:
            n_samples = count("n_samples", n_samples, 2)
            if dt is not None:
                raise InvalidArgumentError(f"n_samples={n_samples} and dt={dt:g} say the same; give one of them")

        if duplicates not in ("refuse", "drop"):
            raise InvalidArgumentError(f"duplicates has to be 'refuse' or 'drop', got {duplicates!r}")
        if dt is not None:
            check_positive("dt", dt)
        x = tensors("positions", positions)
        given = {"times": times, "velocities": velocities, "stiffness": stiffness}
        for what, values in given.items():
            if values is not None and len(values) != len(x):
                raise InvalidDemonstrationsError(
                    f"{what} has to have one array for each of the {len(x)} demonstrations, got {len(values)}"
                )
        v = None if velocities is None else tensors("velocities", velocities)
        s = None if stiffness is None else tensors("stiffness", stiffness)
        found = [
            resample(
                i,
                tensor(f"times of demonstration {i}", times[i]).double().ravel().numpy(force=True),
                x[i],
                None if v is None else v[i],
                None if s is None else s[i],
                dt,
                n_samples,
                kind,
                duplicates == "drop",
            )
            for i in range(len(x))
        ]
        labels = tuple(f"x{d + 1}" for d in range(x[0].shape[1])) if names is None else names
        return cls._of(found, labels, units or "")

    def check(self) -> findings.Findings:
        """What is suspicious about these motions, each with its place and the call that mends it.

        Example:
            >>> import torch, torchds
            >>> x = torch.stack([torch.linspace(0, 1, 50), torch.linspace(0, 2, 50)], -1)
            >>> demos = torchds.Demonstrations([x], [-x.diff(dim=0, append=x[-1:]) / 0.1], dt=0.1)
            >>> [finding.name for finding in demos.check()]
            ['velocity sign']
        """
        return findings.find([findings.Recording(d.x, d.v, d.dt) for d in self], self.names)

    def trim_rests(self) -> Self:
        """Without the samples at both ends during which nothing moves; one of each end stays.

        A rest teaches a time-invariant system to stop there, at the start as well.
        """

        def change(d: Demonstration) -> Demonstration:
            begin, end = findings.resting(d.x)
            if begin >= len(d.x):  # it never moves
                return d
            return _cut(d, begin - 1, len(d.x) - end + 1)

        return self._map(change)

    def unwrap(self, columns: Sequence[int] | None = None, *, period: float | None = None) -> Self:
        """Angles that go on where they jumped by a full turn.

        Args:
            columns: of the angles, from 0; None for those that jump by a turn somewhere.
            period: of a full turn; None for 2π, or 360 where that is what a column jumps by.

        Raises:
            InvalidArgumentError: a column that is not there, or a period that is not positive.
        """
        if period is not None:
            check_positive("period", period)
        seen = {c: turn for d in self for row in findings.jumps(d.x) for c, turn in findings.turns(d.x, row)}
        chosen = sorted(seen) if columns is None else list(columns)
        if strangers := [c for c in chosen if c not in range(self.dim)]:
            raise InvalidArgumentError(f"columns have to be 0 to {self.dim - 1}, got {strangers}")

        def change(d: Demonstration) -> Demonstration:
            x = d.x.numpy(force=True).copy()
            for c in chosen:
                x[:, c] = np.unwrap(x[:, c], period=period or seen.get(c, 2 * math.pi))
            return d._replace(x=torch.from_numpy(x).to(d.x))

        unwrapped = self._map(change)
        jumped = [(a, b) for a, b in zip(self, unwrapped, strict=True) if not torch.equal(a.x, b.x)]
        return unwrapped.differentiate() if jumped and self.differentiated else unwrapped

    def split(self, rows: Sequence[int] | None = None) -> Self:
        """Each demonstration cut into several, after the given rows or where it jumps; parts of one sample are dropped.

        Args:
            rows: after which a new one begins, the same in all demonstrations; None for their own jumps.

        Raises:
            InvalidArgumentError: a row that a demonstration does not have, or nothing to split.
        """
        parts: list[Demonstration] = []
        for i, d in enumerate(self):
            after = sorted(set(findings.jumps(d.x) if rows is None else rows))
            if after and not 0 <= after[0] <= after[-1] < len(d.x) - 1:
                raise InvalidArgumentError(
                    f"rows have to be from 0 to {len(d.x) - 2} for demonstration {i}, got {list(rows or ())}"
                )
            ends = [0, *(row + 1 for row in after), len(d.x)]
            parts += [_cut(d, a, b) for a, b in itertools.pairwise(ends) if b - a > 1]
        if len(parts) == len(self):
            raise InvalidArgumentError("no demonstration has a jump to be split at; give the rows to split after")
        cut = self._of(parts, self.names, self.units)
        return cut.differentiate() if self.differentiated else cut


class Resampled(NamedTuple):
    """A clock that was made even."""

    n_before: int
    n_after: int
    shortest: float  # [s]
    longest: float  # [s]
    dt: float  # [s]


def resample(
    i: int,
    t: np.ndarray,
    x: Tensor,
    v: Tensor | None,
    stiffness: Tensor | None,
    dt: float | None,
    n_samples: int | None,
    kind: Interpolation,
    drop: bool,
) -> Demonstration:
    """One demonstration at equal time steps from samples at the times `t` `(T,)`.

    Raises:
        InvalidDemonstrationsError: see `Mending.from_samples`.
    """
    from scipy.interpolate import CubicSpline, make_interp_spline

    if len(t) != len(x):
        raise InvalidDemonstrationsError(f"demonstration {i} has {len(x)} positions, got {len(t)} times for them")
    if drop and len(t):
        keep = np.concatenate([[True], t[1:] > np.fmax.accumulate(t)[:-1]])
        if not keep.all():
            warnings.warn(
                f"demonstration {i}: {int((~keep).sum())} sample(s) whose time does not rise are dropped",
                DemonstrationWarning,
                stacklevel=3,
            )
        t, rows = t[keep], torch.from_numpy(keep)
        x, v = x[rows], None if v is None else v[rows]
        stiffness = None if stiffness is None else stiffness[rows]
    check_rising(f"demonstration {i}", t)
    least, word = (4, "four") if kind == "cubic" else (2, "two")
    if len(t) < least:
        advice = '; pass kind="linear"' if len(t) > 1 else ""
        raise InvalidDemonstrationsError(
            f"demonstration {i} has {len(t)} samples, a {kind} spline needs at least {word}{advice}"
        )
    steps = np.diff(t)
    span = float(t[-1] - t[0])
    step = float(np.median(steps)) if dt is None else dt
    if n_samples is None and not span / step < MOST_SAMPLES:
        raise InvalidArgumentError(
            f"dt has to give demonstration {i}, which lasts {span:g} s, at most {MOST_SAMPLES} samples, got {step:g} s"
        )
    n = max(round(span / step) + 1, 2) if n_samples is None else n_samples
    report = Resampled(len(t), n, steps.min(), steps.max(), span / (n - 1))

    def between(values: Tensor) -> Any:
        known = values.numpy(force=True)
        return CubicSpline(t - t[0], known) if kind == "cubic" else make_interp_spline(t - t[0], known, k=1)

    at = np.linspace(t[0], t[-1], n) - t[0]
    path = between(x)
    position = torch.from_numpy(path(at)).to(x)
    if v is not None:
        velocity = torch.from_numpy(between(v)(at)).to(x)
    else:
        velocity = torch.from_numpy(path(at, 1)).to(x) if kind == "cubic" else gradient(position, report.dt)
    s = None
    if stiffness is not None:
        columns = stiffness.numpy(force=True).T
        s = torch.from_numpy(np.stack([np.interp(at, t - t[0], column) for column in columns], -1)).to(x)
    if n_samples is None:
        _tell(i, report, steps)
    return Demonstration(position, velocity, report.dt, s)


def check_rising(where: str, t: np.ndarray) -> None:
    """Refuse times that are not finite and rising, with all their digits.

    Raises:
        InvalidDemonstrationsError: which row, and what to do.
    """
    bad = np.flatnonzero(~(np.diff(t) > 0))
    if not np.isfinite(t).all():
        row = int(np.flatnonzero(~np.isfinite(t))[0])
        raise InvalidDemonstrationsError(f"{where}, row {row} (counted from 0): the time {t[row]} is not finite")
    if len(bad):
        row = int(bad[0])
        again = t[row + 1] == t[row]
        advice = 'pass duplicates="drop" to drop the second one' if again else "sort the samples, or split them there"
        raise InvalidDemonstrationsError(
            f"{where}: time {'stands still' if again else 'goes back'} from row {row} to row {row + 1} (counted from 0), "
            f"from {float(t[row])!r} to {float(t[row + 1])!r} s; {advice}"
        )


def _tell(i: int, report: Resampled, steps: np.ndarray) -> None:
    """Say what the clock was and became, and where samples are missing."""
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP * usual)
    text = (
        f"demonstration {i}: {report.n_before} samples at {report.shortest:.6g} to {report.longest:.6g} s resampled to "
        f"{report.n_after} at {report.dt:.6g} s by cubic splines"
    )
    if len(gaps):
        row = int(gaps[0])
        text += f"; {len(gaps)} gap(s) were filled, the first of {steps[row]:.6g} s after row {row} (counted from 0)"
    warnings.warn(text, DemonstrationWarning, stacklevel=4)


def _cut(d: Demonstration, start: int, stop: int) -> Demonstration:
    """Rows start..stop−1."""
    rows = slice(start, stop)
    return Demonstration(d.x[rows], d.v[rows], d.dt, None if d.stiffness is None else d.stiffness[rows])
