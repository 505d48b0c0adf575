"""Stop conditions: where a roll-out comes to rest for good. A stop condition is any function of a step; here, two.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchds.arrays import Array, beside, real
from torchds.devices import Movable
from torchds.errors import InvalidArgumentError
from torchds.kernels.steps import BOUNDS, WALLS, ScalarStep

StopCondition = Callable[[Tensor, Tensor], Tensor]
"""(x, x_next), each `(*batch, *points, D)` -> bool `(*batch, *points)`: True where the step must not be taken."""


@dataclass(frozen=True)
class Bounds(Movable):
    """The stop condition of a box: a step that would leave [low, high], or is not finite, is not taken.

    Args:
        low: number or `(D,)`.
        high: number or `(D,)`.
    """

    low: float | Array
    high: float | Array

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            limit = real(name, getattr(self, name))
            object.__setattr__(self, name, float(limit) if limit.ndim == 0 else limit)

    def __call__(self, x: Tensor, x_next: Tensor) -> Tensor:
        """True where `x_next` is outside."""
        low, high = self._limits(x_next)
        inside: Tensor = ((x_next >= low) & (x_next <= high)).all(-1)
        return ~inside

    def _limits(self, x: Tensor) -> list[Any]:
        """Both limits for states `(..., D)`: numbers as they are, tensors in the dtype of the states."""
        limits = {"low": self.low, "high": self.high}
        return [
            n if isinstance(n, float) else beside(name, n, x, "a number or (D,)", last=0) for name, n in limits.items()
        ]

    def scalar_step(self, n_axes: int, n_rows: int) -> ScalarStep | None:
        """The same for compiled code; None for bounds that differ from roll-out to roll-out."""
        each = torch.empty(n_axes, dtype=torch.float64)
        limits = [torch.as_tensor(limit, dtype=torch.float64) for limit in self._limits(each)]
        if type(self) is not Bounds or any(limit.ndim > 1 for limit in limits):
            return None
        return ScalarStep(BOUNDS, torch.cat([limit.expand(n_axes) for limit in limits]))


@dataclass(frozen=True)
class Walls(Movable):
    """The stop condition of walls in the plane: a step that would cross or touch one is not taken.

    Args:
        segments: `(W, 2, 2)` the ends of each wall.
    """

    segments: Tensor

    def __post_init__(self) -> None:
        segments = real("segments", self.segments)
        if segments.ndim != 3 or segments.shape[1:] != (2, 2):
            raise InvalidArgumentError(f"segments has to be (W, 2, 2), got shape {tuple(segments.shape)}")
        object.__setattr__(self, "segments", segments)

    def __call__(self, x: Tensor, x_next: Tensor) -> Tensor:
        """True where the segment from `x` to `x_next`, each `(..., 2)`, meets a wall."""
        ends = self.segments.to(x)
        p, q = ends.unbind(-2)  # (W, 2)
        a, b = x.unsqueeze(-2), x_next.unsqueeze(-2)  # (..., 1, 2)
        # Each segment's ends lie on different sides of the other one, or on it.
        apart = _side(p, q, a) * _side(p, q, b) <= 0
        across = _side(a, b, p) * _side(a, b, q) <= 0
        # Four points in a row, and a step that rests, are on both sides of everything: what decides are the extents.
        near = (torch.minimum(a, b) <= torch.maximum(p, q)) & (torch.maximum(a, b) >= torch.minimum(p, q))
        return (apart & across & near.all(-1)).any(-1)

    def scalar_step(self, n_axes: int, n_rows: int) -> ScalarStep | None:
        """The same for compiled code."""
        return ScalarStep(WALLS, self.segments.flatten()) if type(self) is Walls and n_axes == 2 else None


def _side(p: Tensor, q: Tensor, x: Tensor) -> Tensor:
    """Twice the signed area of the triangle p, q, x."""
    u, w = q - p, x - p
    return u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]
