"""Demonstrated motions: positions, velocities and stiffness sampled at equal time steps.

`Demonstrations` is an immutable sequence. Methods that change something return a new one, so preparation is a chain:

>>> import torch
>>> t = torch.linspace(0, 1, 51, dtype=torch.float64)[:, None]
>>> demos = Demonstrations([torch.cat([t, t**2], -1)], dt=0.02, units="m")
>>> demos.resample(26).shift_to_goal().scale(1e3, units="mm")
Demonstrations(1 of 26 samples, dimensions x1 [mm], x2 [mm], dt 0.04 s)

Letters: `T` samples, `D` dimensions, `Q` stiffness columns, `M` samples of all demonstrations together.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, SupportsIndex, overload

import numpy as np
import scipy.interpolate
import scipy.io
import scipy.signal
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchds.errors import (
    InvalidArgumentError,
    InvalidDemonstrationsError,
    UnknownNameError,
)

Array = Tensor | ArrayLike


class Demonstration(NamedTuple):
    """One motion."""

    x: Tensor  # (T, D) positions
    v: Tensor  # (T, D) velocities, per second
    dt: float  # [s] between two samples
    stiffness: Tensor | None  # (T, Q)


class Samples(NamedTuple):
    """The samples of all demonstrations, one after the other."""

    x: Tensor  # (M, D)
    v: Tensor  # (M, D)
    stiffness: Tensor | None  # (M, Q)


class Demonstrations(Sequence[Demonstration]):
    """An immutable list of motions with the same dimensions.

    float32 and float64 data keep their dtype, everything else becomes float64. The data are copied.

    Args:
        x: positions, one (T, D) array per demonstration; T may differ.
        v: velocities, shaped as `x`; None takes finite differences of `x` (see `differentiate`).
        dt: time between two samples [s], one for all or one per demonstration.
        stiffness: one (T, Q) array per demonstration, or None.
        names: one name per dimension; x1, x2, ... by default.
        units: units of the positions, one for all dimensions or one for each.

    Raises:
        InvalidDemonstrationsError: the data are too short, not finite, of mixed shapes, or have no time step.
        InvalidArgumentError: `dt`, `names` or `units` do not fit the number of demonstrations or dimensions.
    """

    __slots__ = ("_demonstrations", "_names", "_units")

    def __init__(
        self,
        x: Sequence[Array] | Tensor,
        v: Sequence[Array] | Tensor | None = None,
        dt: float | Sequence[float] | None = None,
        *,
        stiffness: Sequence[Array] | Tensor | None = None,
        names: Sequence[str] | None = None,
        units: str | Sequence[str] | None = None,
    ) -> None:
        positions = _tensors("x", x)
        for i, x_i in enumerate(positions):
            if len(x_i) < 2:
                raise InvalidDemonstrationsError(
                    f"demonstration {i} has {len(x_i)} sample(s), at least two are needed. Leave it out."
                )
        dim = positions[0].shape[1]
        self._names = tuple(f"x{d + 1}" for d in range(dim)) if names is None else tuple(names)
        self._units = (units or "",) * dim if units is None or isinstance(units, str) else tuple(units)
        _check_labels(dim, self._names, self._units)
        _check_finite(positions, self._names)

        if dt is None:
            raise InvalidDemonstrationsError("the demonstrations have no time step. Pass dt= in seconds.")
        steps = per_demonstration("dt", dt, len(positions))
        for i, step in enumerate(steps):
            if not 0 < step < math.inf:
                raise InvalidDemonstrationsError(
                    f"dt of demonstration {i} is {step}; it must be positive and finite. Pass the time step in seconds."
                )
        velocities = [_gradient(x_i, step) for x_i, step in zip(positions, steps, strict=True)]
        if v is not None:
            velocities = _matching("v", v, positions)
            for i, (x_i, v_i) in enumerate(zip(positions, velocities, strict=True)):
                if v_i.shape != x_i.shape:
                    raise InvalidDemonstrationsError(
                        f"demonstration {i}: x has shape {tuple(x_i.shape)} but v has {tuple(v_i.shape)}. Give one "
                        "velocity per position, or leave v out and it is taken from the positions."
                    )
            _check_finite(velocities, [f"velocity of {name}" for name in self._names])
        rows: Sequence[Tensor | None] = [None] * len(positions)
        if stiffness is not None:
            rows = columns = _matching("stiffness", stiffness, positions)
            _check_finite(columns, [f"stiffness {q}" for q in range(columns[0].shape[1])])
        self._demonstrations = tuple(map(Demonstration, positions, velocities, steps, rows))

    @classmethod
    def _of(cls, demos: Iterable[Demonstration], names: Sequence[str], units: Sequence[str]) -> Demonstrations:
        x, v, dt, stiffness = zip(*demos, strict=True)
        return cls(x, v, dt, stiffness=None if stiffness[0] is None else stiffness, names=names, units=units)

    def _map(self, change: Callable[[Demonstration], Demonstration]) -> Demonstrations:
        return self._of(map(change, self), self.names, self.units)

    # -- a sequence ---------------------------------------------------------------------------------------------------

    @overload
    def __getitem__(self, index: SupportsIndex) -> Demonstration: ...
    @overload
    def __getitem__(self, index: slice) -> Demonstrations: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Demonstration | Demonstrations:
        """One demonstration, or with a slice a shorter `Demonstrations`."""
        if not isinstance(index, slice):
            return self._demonstrations[index]
        chosen = self._demonstrations[index]
        if not chosen:
            raise InvalidArgumentError(f"the slice {index} leaves none of the {len(self)} demonstrations.")
        return self._of(chosen, self.names, self.units)

    def __len__(self) -> int:
        return len(self._demonstrations)

    def __add__(self, other: Demonstrations) -> Demonstrations:
        """Both sets one after the other; names of the left one."""
        if not isinstance(other, Demonstrations):
            return NotImplemented
        if self.dim != other.dim:
            raise InvalidArgumentError(f"cannot add demonstrations of {self.dim} and of {other.dim} dimensions.")
        if any(a and b and a != b for a, b in zip(self.units, other.units, strict=True)):
            raise InvalidArgumentError(
                f"cannot add demonstrations in {self.units} and in {other.units}. Bring both to one unit with scale()."
            )
        if (self[0].stiffness is None) != (other[0].stiffness is None):
            raise InvalidArgumentError(
                "cannot add demonstrations with and without stiffness. Give both a stiffness with with_stiffness()."
            )
        units = [a or b for a, b in zip(self.units, other.units, strict=True)]
        return self._of([*self, *other], self.names, units)

    def __repr__(self) -> str:
        """Counts, lengths, dimensions and time steps on one line."""
        names = ", ".join(
            f"{name} [{unit}]" if unit else name for name, unit in zip(self.names, self.units, strict=True)
        )
        stiffness = self[0].stiffness
        return (
            f"Demonstrations({len(self)} of {_span([len(d.x) for d in self])} samples, dimensions {names}, "
            f"dt {_span(self.dt)} s{'' if stiffness is None else f', stiffness {stiffness.shape[1]}'})"
        )

    @property
    def dim(self) -> int:
        """Number of dimensions D."""
        return self[0].x.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        """One name per dimension."""
        return self._names

    @property
    def units(self) -> tuple[str, ...]:
        """One unit per dimension, "" where it is not known."""
        return self._units

    @property
    def dt(self) -> tuple[float, ...]:
        """Time step of each demonstration [s]."""
        return tuple(d.dt for d in self)

    # -- sampling and velocities --------------------------------------------------------------------------------------

    def resample(self, n_samples: int, kind: str = "linear") -> Demonstrations:
        """Every demonstration at `n_samples` equally spaced times from its first to its last sample.

        Args:
            n_samples: at least two.
            kind: "linear" or "cubic" interpolation of positions and velocities. Stiffness is always interpolated
                linearly, so it stays within the values given.

        Raises:
            InvalidArgumentError: `n_samples` is below two, or a demonstration is too short for cubic interpolation.
            UnknownNameError: `kind` is neither of the two.
        """
        _check_count("n_samples", n_samples, 2)
        degrees = {"linear": 1, "cubic": 3}
        if kind not in degrees:
            raise UnknownNameError("interpolation", kind, degrees)
        degree = degrees[kind]
        for i, d in enumerate(self):
            if len(d.x) <= degree:
                raise InvalidArgumentError(
                    f'demonstration {i} has {len(d.x)} samples; cubic interpolation needs four. Use kind="linear".'
                )

        def interpolate(values: Tensor, degree: int) -> Tensor:
            last = len(values) - 1
            spline = scipy.interpolate.make_interp_spline(np.arange(last + 1.0), values.numpy(force=True), k=degree)
            return torch.from_numpy(spline(np.linspace(0, last, n_samples))).to(values)

        def change(d: Demonstration) -> Demonstration:
            return Demonstration(
                x=interpolate(d.x, degree),
                v=interpolate(d.v, degree),
                dt=d.dt * (len(d.x) - 1) / (n_samples - 1),
                stiffness=None if d.stiffness is None else interpolate(d.stiffness, 1),
            )

        return self._map(change)

    def every(self, n: int) -> Demonstrations:
        """Every n-th sample from the first on; `dt` grows n-fold. The last sample stays only if it falls on the grid.

        Raises:
            InvalidArgumentError: `n` is below one or leaves a demonstration with fewer than two samples.
        """
        _check_count("n", n, 1)
        for i, d in enumerate(self):
            if len(d.x) <= n:
                raise InvalidArgumentError(
                    f"every({n}) leaves one of the {len(d.x)} samples of demonstration {i}. Take n < {len(d.x)}."
                )
        return self._map(
            lambda d: Demonstration(d.x[::n], d.v[::n], d.dt * n, _rows(d.stiffness, slice(None, None, n)))
        )

    def smooth(self, window: int, order: int = 3) -> Demonstrations:
        """Savitzky-Golay filter: polynomials fitted in a moving window give positions and, by derivative, velocities.

        Args:
            window: number of samples, odd.
            order: degree of the polynomial, at least 1 and below `window`.

        Raises:
            InvalidArgumentError: `window` or `order` is not allowed, or `window` exceeds a demonstration.
        """
        _check_count("order", order, 1)
        _check_count("window", window, order + 1)
        if window % 2 == 0:
            raise InvalidArgumentError(f"window is {window}; it must be odd. Use {window + 1}.")
        for i, d in enumerate(self):
            if window > len(d.x):
                raise InvalidArgumentError(
                    f"window is {window} but demonstration {i} has {len(d.x)} samples. Use a window of at most that."
                )

        def change(d: Demonstration) -> Demonstration:
            fit = functools.partial(scipy.signal.savgol_filter, d.x.numpy(force=True), window, order, axis=0)
            x, v = (torch.from_numpy(values).to(d.x) for values in (fit(), fit(deriv=1, delta=d.dt)))
            return d._replace(x=x, v=v)

        return self._map(change)

    def differentiate(self) -> Demonstrations:
        """Velocities taken anew from the positions: central differences, second order at both ends too."""
        return self._map(lambda d: d._replace(v=_gradient(d.x, d.dt)))

    def forward_differences(self) -> Demonstrations:
        """Velocities that carry each position to the next in one Euler step; the last sample has none and is dropped.

        Raises:
            InvalidDemonstrationsError: a demonstration of two samples would keep only one.
        """
        return self._map(lambda d: Demonstration(d.x[:-1], d.x.diff(dim=0) / d.dt, d.dt, _rows(d.stiffness, slice(-1))))

    # -- space, time and stiffness ------------------------------------------------------------------------------------

    def shift_to_goal(self, goal: Array | None = None) -> Demonstrations:
        """Each demonstration moved so that its last position is the goal.

        Args:
            goal: (D,), the origin by default.

        Raises:
            InvalidArgumentError: `goal` has another shape or is not finite.
        """
        end = _vector("goal", torch.zeros(self.dim) if goal is None else goal)
        if len(end) != self.dim:
            raise InvalidArgumentError(f"goal has {len(end)} entries; these demonstrations have {self.dim} dimensions.")
        return self._map(lambda d: d._replace(x=d.x - d.x[-1] + end.to(d.x)))

    def scale(self, factor: float, units: str | Sequence[str] | None = None) -> Demonstrations:
        """Positions and velocities times a positive `factor`; name the new `units` if they are others.

        Raises:
            InvalidArgumentError: `factor` is not positive and finite, or `units` does not fit.
        """
        _check_positive("factor", factor)
        scaled = [d._replace(x=d.x * factor, v=d.v * factor) for d in self]
        return self._of(scaled, self.names, self.units if units is None else units)

    def retime(self, duration: float) -> Demonstrations:
        """Each demonstration stretched to last `duration` [s] from first to last sample, its velocities slowed alike.

        Raises:
            InvalidArgumentError: `duration` is not positive and finite.
        """
        _check_positive("duration", duration)

        def change(d: Demonstration) -> Demonstration:
            dt = duration / (len(d.x) - 1)
            return d._replace(v=d.v * (d.dt / dt), dt=dt)

        return self._map(change)

    def mirror(self, dim: int) -> Demonstrations:
        """Positions and velocities of one dimension, counted from 0, with the opposite sign.

        Raises:
            InvalidArgumentError: there is no such dimension.
        """
        if dim not in range(-self.dim, self.dim):
            raise InvalidArgumentError(f"dim is {dim}; these demonstrations have dimensions 0 to {self.dim - 1}.")
        sign = torch.ones(self.dim)
        sign[dim] = -1
        return self._map(lambda d: d._replace(x=d.x * sign.to(d.x), v=d.v * sign.to(d.x)))

    def with_stiffness(self, value: float | Sequence[float] | Tensor) -> Demonstrations:
        """The same demonstrations with a constant stiffness: one number, or Q numbers for Q columns.

        Raises:
            InvalidArgumentError: `value` has another shape or is not finite.
        """
        row = _vector("stiffness", value)
        return self._map(lambda d: d._replace(stiffness=row.to(d.x).expand(len(d.x), -1)))

    # -- out ----------------------------------------------------------------------------------------------------------

    def stacked(self) -> Samples:
        """All samples below each other: x (M, D), v (M, D), stiffness (M, Q) or None."""
        stiffness = [d.stiffness for d in self if d.stiffness is not None]
        return Samples(
            torch.cat([d.x for d in self]), torch.cat([d.v for d in self]), torch.cat(stiffness) if stiffness else None
        )

    def save_npz(self, path: str | Path) -> None:
        """Write a file that `load_npz` reads back exactly.

        Raises:
            InvalidArgumentError: the name does not end in .npz.
        """
        if Path(path).suffix.lower() != ".npz":
            raise InvalidArgumentError(f"{path} does not end in .npz. Write to {Path(path).with_suffix('.npz')}.")
        arrays: dict[str, np.ndarray] = {}
        for i, d in enumerate(self):
            for field, value in (("x", d.x), ("v", d.v), ("stiffness", d.stiffness)):
                if value is not None:
                    arrays[f"demo{i}_{field}"] = value.numpy(force=True)
        with Path(path).open("wb") as file:
            np.savez(
                file,
                dt=np.array(self.dt),
                names=np.array(self.names),
                units=np.array(self.units),
                **arrays,  # type: ignore[arg-type]  # numpy's stub lets allow_pickle clash with every keyword
            )


# -- checks ------------------------------------------------------------------------------------------------------------


def _tensor(where: str, value: Array) -> Tensor:
    """A copy as float32 or float64 tensor."""
    if isinstance(value, Tensor):
        keep = value.dtype in (torch.float32, torch.float64)
        real = not value.is_complex()
    else:
        try:
            array = np.asarray(value)
        except ValueError:
            array = np.empty(0, dtype=object)  # rows of different lengths
        real = array.dtype.kind in "biuf"
        keep = array.dtype == np.float32
        if real:
            value = torch.from_numpy(np.array(array, dtype=np.float32 if keep else np.float64, order="C"))
    if not real or not isinstance(value, Tensor):
        raise InvalidDemonstrationsError(f"{where} is not an array of real numbers with rows of equal length.")
    return value.detach().to(value.dtype if keep else torch.float64, copy=True)


def _tensors(what: str, arrays: Sequence[Array] | Tensor) -> list[Tensor]:
    """One (T, C) tensor per demonstration with equal C, dtype and device."""
    values = [_tensor(f"{what} of demonstration {i}", array) for i, array in enumerate(arrays)]
    if not values:
        raise InvalidDemonstrationsError("there are no demonstrations. Pass at least one array of positions (T, D).")
    for i, value in enumerate(values):
        if value.ndim != 2 or not value.shape[1]:
            raise InvalidDemonstrationsError(
                f"{what} of demonstration {i} has shape {tuple(value.shape)}; expected is (T, D), samples in rows and "
                f"dimensions in columns. A single demonstration is passed in a list, [{what}]."
            )
        if value.shape[1] != values[0].shape[1]:
            raise InvalidDemonstrationsError(
                f"{what} of demonstration {i} has {value.shape[1]} columns but that of demonstration 0 has "
                f"{values[0].shape[1]}. All demonstrations need the same."
            )
    dtype = functools.reduce(torch.promote_types, [value.dtype for value in values])
    return [value.to(values[0].device, dtype) for value in values]


def _matching(what: str, arrays: Sequence[Array] | Tensor, positions: list[Tensor]) -> list[Tensor]:
    """As `_tensors`, with as many rows as there are positions."""
    if len(arrays) != len(positions):
        raise InvalidDemonstrationsError(f"there are {len(arrays)} arrays {what} for {len(positions)} demonstrations.")
    values = [value.to(positions[0]) for value in _tensors(what, arrays)]
    for i, (x, value) in enumerate(zip(positions, values, strict=True)):
        if len(value) != len(x):
            raise InvalidDemonstrationsError(
                f"demonstration {i}: x has shape {tuple(x.shape)} but {what} has {tuple(value.shape)}. "
                "Give one row per position."
            )
    return values


def _check_labels(dim: int, names: Sequence[str], units: Sequence[str]) -> None:
    for what, labels in (("names", names), ("units", units)):
        if len(labels) != dim:
            raise InvalidArgumentError(f"{len(labels)} {what} {labels} for {dim} dimensions. Give one per dimension.")
    if len(set(names)) < dim:
        raise InvalidArgumentError(f"names {names} has duplicates. Give every dimension its own name.")


def _check_finite(values: list[Tensor], columns: Sequence[str]) -> None:
    for i, value in enumerate(values):
        bad = (~value.isfinite()).nonzero()
        if len(bad):
            row, column = bad[0].tolist()
            raise InvalidDemonstrationsError(
                f"demonstration {i}, row {row} (counted from 0), column {columns[column]!r}: "
                f"{value[row, column].item()} is not finite. Remove the row or fill it in."
            )


def _check_count(name: str, value: int, minimum: int) -> None:
    try:
        fits = operator.index(value) >= minimum
    except TypeError:
        fits = False
    if not fits:
        raise InvalidArgumentError(f"{name} is {value!r}; it must be an integer of at least {minimum}.")


def _check_positive(name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise InvalidArgumentError(f"{name} is {value!r}; it must be positive and finite.")


def _vector(name: str, value: Array) -> Tensor:
    """A finite (C,) tensor, of one number too."""
    vector = torch.atleast_1d(_tensor(name, value))
    if vector.ndim != 1 or not len(vector) or not vector.isfinite().all():
        raise InvalidArgumentError(f"{name} is {value!r}; it must be one row of finite numbers.")
    return vector


def per_demonstration(
    name: str, value: float | Sequence[float] | np.ndarray, n: int, error: type[Exception] = InvalidArgumentError
) -> list[float]:
    """One number for each of `n` demonstrations, from one for all or one each."""
    try:
        steps = np.asarray(value, dtype=float).ravel().tolist()
    except (TypeError, ValueError):
        raise error(f"{name} is {value!r}; it must be a number [s], or one for each demonstration.") from None
    if len(steps) not in (1, n):
        raise error(f"{name} has {len(steps)} values for {n} demonstrations. Give one for all or one for each.")
    return steps * n if len(steps) == 1 else steps


# -- small maths -------------------------------------------------------------------------------------------------------


def _gradient(x: Tensor, dt: float) -> Tensor:
    (v,) = torch.gradient(x, spacing=dt, dim=0, edge_order=min(2, len(x) - 1))
    return v


def _rows(values: Tensor | None, rows: slice) -> Tensor | None:
    return None if values is None else values[rows]


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.4g}", f"{max(values):.4g}"
    return low if low == high else f"{low} to {high}"
