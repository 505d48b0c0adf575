"""Demonstrated motions: positions, velocities and stiffness sampled at equal time steps.

`Demonstrations` is an immutable sequence. Methods that change something return a new one, so preparation is a chain:

>>> import torch
>>> t = torch.linspace(0, 1, 51, dtype=torch.float64)[:, None]
>>> demos = Demonstrations([torch.cat([t, t**2], -1)], dt=0.02, units="m")
>>> demos.resample(26).shift_to_goal().scale(1e3, units="mm")
Demonstrations(1 of 26 samples, dimensions x1 [mm], x2 [mm], dt 0.04 s)

Letters: `T` samples, `D` dimensions, `Q` stiffness columns, `M` samples of all demonstrations together.

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, Self, SupportsIndex, overload

import numpy as np
import torch
from torch import Tensor

from torchds.arrays import Array, check_finite, check_labels, matching, per_demonstration, tensors
from torchds.devices import Device, moved
from torchds.errors import InvalidArgumentError, InvalidDemonstrationsError
from torchds.files import write_npz
from torchds.mending import Mending
from torchds.preparation import Demonstration as Demonstration
from torchds.preparation import gradient


class Samples(NamedTuple):
    """The samples of all demonstrations, one after the other."""

    x: Tensor  # (M, D)
    v: Tensor  # (M, D)
    stiffness: Tensor | None  # (M, Q)


class Demonstrations(Mending):
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
        positions = tensors("x", x)
        for i, x_i in enumerate(positions):
            if len(x_i) < 2:
                raise InvalidDemonstrationsError(
                    f"demonstration {i} has to have at least two samples, got {len(x_i)}; leave it out"
                )
        dim = positions[0].shape[1]
        self._names = tuple(f"x{d + 1}" for d in range(dim)) if names is None else tuple(names)
        self._units = (units or "",) * dim if units is None or isinstance(units, str) else tuple(units)
        check_labels(dim, self._names, self._units)
        check_finite(positions, self._names)

        if dt is None:
            raise InvalidDemonstrationsError("dt has to be the time step in seconds, got none; pass dt=")
        steps = per_demonstration("dt", dt, len(positions))
        for i, step in enumerate(steps):
            if not 0 < step < math.inf:
                raise InvalidDemonstrationsError(
                    f"dt of demonstration {i} has to be positive and finite [s], got {step}"
                )
        velocities = [gradient(x_i, step) for x_i, step in zip(positions, steps, strict=True)]
        if v is not None:
            velocities = matching("v", v, positions)
            for i, (x_i, v_i) in enumerate(zip(positions, velocities, strict=True)):
                if v_i.shape != x_i.shape:
                    raise InvalidDemonstrationsError(
                        f"demonstration {i}: v has to have the shape {tuple(x_i.shape)} of x, got {tuple(v_i.shape)}; give one "
                        "velocity per position, or leave v out and it is taken from the positions"
                    )
        check_finite(velocities, [f"velocity of {name}" for name in self._names])
        rows: Sequence[Tensor | None] = [None] * len(positions)
        if stiffness is not None:
            rows = columns = matching("stiffness", stiffness, positions)
            check_finite(columns, [f"stiffness {q}" for q in range(columns[0].shape[1])])
        self._demonstrations = tuple(map(Demonstration, positions, velocities, steps, rows))

    @classmethod
    def _of(cls, demos: Iterable[Demonstration], names: Sequence[str], units: str | Sequence[str]) -> Self:
        x, v, dt, stiffness = zip(*demos, strict=True)
        return cls(x, v, dt, stiffness=None if stiffness[0] is None else stiffness, names=names, units=units)

    # -- a sequence ---------------------------------------------------------------------------------------------------

    @overload
    def __getitem__(self, index: SupportsIndex) -> Demonstration: ...
    @overload
    def __getitem__(self, index: slice) -> Self: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Demonstration | Self:
        """One demonstration, or with a slice a shorter `Demonstrations`."""
        if not isinstance(index, slice):
            return self._demonstrations[index]
        chosen = self._demonstrations[index]
        if not chosen:
            raise InvalidArgumentError(
                f"a slice has to leave at least one of the {len(self)} demonstrations, got {index}"
            )
        return self._of(chosen, self.names, self.units)

    def __len__(self) -> int:
        return len(self._demonstrations)

    def __add__(self, other: Demonstrations) -> Self:
        """Both sets one after the other; names of the left one."""
        if not isinstance(other, Demonstrations):
            return NotImplemented
        if self.dim != other.dim:
            raise InvalidArgumentError(f"demonstrations to add have to have {self.dim} dimensions, got {other.dim}")
        if any(a and b and a != b for a, b in zip(self.units, other.units, strict=True)):
            raise InvalidArgumentError(
                f"demonstrations to add have to be in {self.units}, got {other.units}; bring both to one unit with scale()"
            )
        if (self[0].stiffness is None) != (other[0].stiffness is None):
            raise InvalidArgumentError(
                "demonstrations to add have to have a stiffness both or neither; give it to both with with_stiffness()"
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

    def to(self, device: Device = None, dtype: torch.dtype | None = None) -> Self:
        """The same motions on `device` and in `dtype`, where given."""
        return self._of((Demonstration(*moved(tuple(d), device, dtype)) for d in self), self.names, self.units)

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
            raise InvalidArgumentError(
                f"path has to end in .npz, got {path}; write to {Path(path).with_suffix('.npz')}"
            )
        arrays: dict[str, np.ndarray] = {}
        for i, d in enumerate(self):
            for field, value in (("x", d.x), ("v", d.v), ("stiffness", d.stiffness)):
                if value is not None:
                    arrays[f"demo{i}_{field}"] = value.numpy(force=True)
        said = {"dt": np.array(self.dt), "names": np.array(self.names), "units": np.array(self.units)}
        write_npz(path, {**said, **arrays})


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.4g}", f"{max(values):.4g}"
    return low if low == high else f"{low} to {high}"
