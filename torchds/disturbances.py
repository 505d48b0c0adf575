"""What chance does to a plant and to its sensors, drawn before the roll-outs, so that all backends see the same.

Stability: stable.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchds import sharing
from torchds.arrays import count, number, over


class Disturbance(NamedTuple):
    """The disturbances of one set of roll-outs, step by step; none in the steps that come after the last one.

    Attributes:
        position: `(*batch, *points, T, D)` what the measured position is wrong by.
        velocity: `(*batch, *points, T, D)` what the measured velocity is wrong by.
        force: `(*batch, *points, T, D)` a force beside all others [N].
    """

    position: Tensor
    velocity: Tensor
    force: Tensor

    def at(self, t: Any, dt: float, x: Tensor) -> Disturbance:
        """Those of the step that begins at `t`, for states `x` `(*batch, *points, D)`; a tensor in a program that is traced.

        Raises:
            InvalidArgumentError: they are not of these roll-outs.
        """
        return Disturbance(*(over("the disturbance of a step", e, x, "(*batch, *points, D)") for e in self._of(t, dt)))

    def _of(self, t: Any, dt: float) -> Disturbance:
        n = self.force.shape[-2]
        if not isinstance(t, Tensor):
            i = round(t / dt)
            return Disturbance(*(e[..., i, :] if i < n else torch.zeros_like(e[..., 0, :]) for e in self))
        step = (t / dt).round().long().reshape(1)
        return Disturbance(*(e.index_select(-2, step.clamp_max(n - 1)).squeeze(-2).where(step < n, 0.0) for e in self))

    @property
    def flat(self) -> Tensor:
        """`(*batch, *points, T · 3D)` all of it, one step after the other, as compiled code reads it."""
        return torch.cat(list(self), -1).flatten(-2)


def draw(
    shape: tuple[int, ...],
    n_steps: int,
    dt: float,
    *,
    sensor: float = 0.0,
    push: float = 0.0,
    duration: float = 1.0,
    generator: torch.Generator | None = None,
    dtype: torch.dtype = torch.float64,
) -> Disturbance:
    """Draw sensor noise and one push for each roll-out, on the CPU.

    The measured position is wrong by independent normal numbers, the measured velocity by their differences over time, as
    where it is computed from positions. The push begins at any time and is a constant force in a random direction. Where
    roll-outs are shared out over processes, each gets the disturbances that it has in one process (`torchds.sharing`).

    Args:
        shape: `(*batch, *points, D)`.
        n_steps: T.
        dt: time step [s].
        sensor: standard deviation of the measured position in each axis [position unit].
        push: standard deviation of the force in each axis [N].
        duration: of the push [s], one time step at least.
        generator: of the random numbers; None for torch's own.
        dtype: of the tensors.

    Raises:
        InvalidArgumentError: a standard deviation that is negative or not finite, a time that is not positive, no steps.
    """
    n_steps = count("n_steps", n_steps, 1)
    for name, value in (("sensor", sensor), ("push", push)):
        number(name, value, "finite and at least 0", lambda std: 0 <= std < math.inf)
    for name, value in (("dt", dt), ("duration", duration)):
        number(name, value, "finite and positive", lambda time: 0 < time < math.inf)
    *lead, D = shape
    normal, uniform = (functools.partial(of, generator=generator, dtype=dtype) for of in (torch.randn, torch.rand))
    wrong = sensor * sharing.drawn((*lead, n_steps + 1, D), normal)
    force = push * sharing.drawn((*lead, 1, D), normal)
    begin = sharing.drawn((*lead, 1, 1), uniform) * n_steps
    since = torch.arange(n_steps, dtype=dtype).unsqueeze(-1) - begin.floor()  # steps since the push began, (..., T, 1)
    pushed = (since >= 0) & (since < max(1, round(duration / dt)))
    return Disturbance(wrong[..., 1:, :], wrong.diff(dim=-2) / dt, force.where(pushed, 0.0))
