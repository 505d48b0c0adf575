"""Preparing demonstrations for a fit: sampling, smoothing, velocities, places, durations.

Stability: stable.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from torchds.arrays import Array, check_count, check_positive, vector
from torchds.errors import InvalidArgumentError, UnknownNameError


class Demonstration(NamedTuple):
    """One motion."""

    x: Tensor  # (T, D) positions
    v: Tensor  # (T, D) velocities, per second
    dt: float  # [s] between two samples
    stiffness: Tensor | None  # (T, Q)


class Preparation(Sequence[Demonstration]):
    """The part of `Demonstrations` that returns changed ones; what stands here is reached through them."""

    __slots__ = ()

    @property
    @abstractmethod
    def dim(self) -> int:
        """Number of dimensions D."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """One name per dimension."""

    @property
    @abstractmethod
    def units(self) -> tuple[str, ...]:
        """One unit per dimension, "" where it is not known."""

    @classmethod
    @abstractmethod
    def _of(cls, demos: Iterable[Demonstration], names: Sequence[str], units: str | Sequence[str]) -> Self:
        """The same kind of sequence, of other demonstrations."""

    def _map(self, change: Callable[[Demonstration], Demonstration]) -> Self:
        return self._of(map(change, self), self.names, self.units)

    # -- sampling and velocities --------------------------------------------------------------------------------------

    def resample(self, n_samples: int, kind: str = "linear") -> Self:
        """Every demonstration at `n_samples` equally spaced times from its first to its last sample.

        Args:
            n_samples: at least two.
            kind: "linear" or "cubic" interpolation of positions and velocities. Stiffness is always interpolated
                linearly, so it stays within the values given.

        Raises:
            InvalidArgumentError: `n_samples` is below two, or a demonstration is too short for cubic interpolation.
            UnknownNameError: `kind` is neither of the two.
        """
        check_count("n_samples", n_samples, 2)
        degrees = {"linear": 1, "cubic": 3}
        if kind not in degrees:
            raise UnknownNameError("interpolation", kind, degrees)
        degree = degrees[kind]
        for i, d in enumerate(self):
            if len(d.x) <= degree:
                raise InvalidArgumentError(
                    f'cubic interpolation needs four samples, got {len(d.x)} in demonstration {i}; use kind="linear"'
                )

        from scipy.interpolate import make_interp_spline

        def interpolate(values: Tensor, degree: int) -> Tensor:
            last = len(values) - 1
            spline = make_interp_spline(np.arange(last + 1.0), values.numpy(force=True), k=degree)
            return torch.from_numpy(spline(np.linspace(0, last, n_samples))).to(values)

        def change(d: Demonstration) -> Demonstration:
            return Demonstration(
                x=interpolate(d.x, degree),
                v=interpolate(d.v, degree),
                dt=d.dt * (len(d.x) - 1) / (n_samples - 1),
                stiffness=None if d.stiffness is None else interpolate(d.stiffness, 1),
            )

        return self._map(change)

    def every(self, n: int) -> Self:
        """Every n-th sample from the first on; `dt` grows n-fold. The last sample stays only if it falls on the grid.

        Raises:
            InvalidArgumentError: `n` is below one or leaves a demonstration with fewer than two samples.
        """
        check_count("n", n, 1)
        for i, d in enumerate(self):
            if len(d.x) <= n:
                raise InvalidArgumentError(f"n has to be below the {len(d.x)} samples of demonstration {i}, got {n}")
        return self._map(
            lambda d: Demonstration(d.x[::n], d.v[::n], d.dt * n, _rows(d.stiffness, slice(None, None, n)))
        )

    def smooth(self, window: int, order: int = 3) -> Self:
        """Savitzky-Golay filter: polynomials fitted in a moving window give positions and, by derivative, velocities.

        Args:
            window: number of samples, odd.
            order: degree of the polynomial, at least 1 and below `window`.

        Raises:
            InvalidArgumentError: `window` or `order` is not allowed, or `window` exceeds a demonstration.
        """
        check_count("order", order, 1)
        check_count("window", window, order + 1)
        if window % 2 == 0:
            raise InvalidArgumentError(f"window has to be odd, got {window}; use {window + 1}")
        for i, d in enumerate(self):
            if window > len(d.x):
                raise InvalidArgumentError(
                    f"window has to be at most the {len(d.x)} samples of demonstration {i}, got {window}"
                )

        from scipy.signal import savgol_filter

        def change(d: Demonstration) -> Demonstration:
            fit = partial(savgol_filter, d.x.numpy(force=True), window, order, axis=0)
            x, v = (torch.from_numpy(values).to(d.x) for values in (fit(), fit(deriv=1, delta=d.dt)))
            return d._replace(x=x, v=v)

        return self._map(change)

    def differentiate(self) -> Self:
        """Velocities taken anew from the positions: central differences, second order at both ends too."""
        return self._map(lambda d: d._replace(v=gradient(d.x, d.dt)))

    @property
    def differentiated(self) -> bool:
        """Whether all velocities are those of `differentiate`, but for round-off, so that positions alone were recorded."""

        def alike(d: Demonstration) -> bool:
            size = float(d.x.abs().max()) * torch.finfo(d.x.dtype).eps / d.dt  # how finely differences can be told
            return torch.allclose(d.v, gradient(d.x, d.dt), rtol=0.0, atol=16 * size)

        return all(map(alike, self))

    def forward_differences(self) -> Self:
        """Velocities that carry each position to the next in one Euler step; the last sample has none and is dropped.

        Raises:
            InvalidDemonstrationsError: a demonstration of two samples would keep only one.
        """
        return self._map(lambda d: Demonstration(d.x[:-1], d.x.diff(dim=0) / d.dt, d.dt, _rows(d.stiffness, slice(-1))))

    # -- space, time and stiffness ------------------------------------------------------------------------------------

    def shift_to_goal(self, goal: Array | None = None) -> Self:
        """Each demonstration moved so that its last position is the goal.

        Args:
            goal: (D,), the origin by default.

        Raises:
            InvalidArgumentError: `goal` has another shape or is not finite.
        """
        end = vector("goal", torch.zeros(self.dim) if goal is None else goal)
        if len(end) != self.dim:
            raise InvalidArgumentError(f"goal has to be ({self.dim},) for these demonstrations, got ({len(end)},)")
        return self._map(lambda d: d._replace(x=d.x - d.x[-1] + end.to(d.x)))

    def scale(self, factor: float, units: str | Sequence[str] | None = None) -> Self:
        """Positions and velocities times a positive `factor`; name the new `units` if they are others.

        Raises:
            InvalidArgumentError: `factor` is not positive and finite, or `units` does not fit.
        """
        check_positive("factor", factor)
        scaled = [d._replace(x=d.x * factor, v=d.v * factor) for d in self]
        return self._of(scaled, self.names, self.units if units is None else units)

    def retime(self, duration: float) -> Self:
        """Each demonstration stretched to last `duration` [s] from first to last sample, its velocities slowed alike.

        Raises:
            InvalidArgumentError: `duration` is not positive and finite.
        """
        check_positive("duration", duration)

        def change(d: Demonstration) -> Demonstration:
            dt = duration / (len(d.x) - 1)
            return d._replace(v=d.v * (d.dt / dt), dt=dt)

        return self._map(change)

    def mirror(self, dim: int) -> Self:
        """Positions and velocities of one dimension, counted from 0, with the opposite sign.

        Raises:
            InvalidArgumentError: there is no such dimension.
        """
        if dim not in range(-self.dim, self.dim):
            raise InvalidArgumentError(f"dim has to be 0 to {self.dim - 1} for these demonstrations, got {dim}")
        sign = torch.ones(self.dim)
        sign[dim] = -1
        return self._map(lambda d: d._replace(x=d.x * sign.to(d.x), v=d.v * sign.to(d.x)))

    def with_stiffness(self, value: float | Sequence[float] | Tensor) -> Self:
        """The same demonstrations with a constant stiffness: one number, or Q numbers for Q columns.

        Raises:
            InvalidArgumentError: `value` has another shape or is not finite.
        """
        row = vector("stiffness", value)
        return self._map(lambda d: d._replace(stiffness=row.to(d.x).expand(len(d.x), -1)))


def gradient(x: Tensor, dt: float) -> Tensor:
    """Central differences of `x` `(T, D)`, second order at both ends too where there are three samples."""
    (v,) = torch.gradient(x, spacing=dt, dim=0, edge_order=min(2, len(x) - 1))
    return v


def _rows(values: Tensor | None, rows: slice) -> Tensor | None:
    return None if values is None else values[rows]
