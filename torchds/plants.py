"""Plants: what tracks the reference motion. A plant is anything with `reset` and `step`; here, a point mass.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from torchds.arrays import number, over
from torchds.devices import Movable
from torchds.errors import InvalidArgumentError

Force = Callable[[float, Tensor, Tensor], Tensor]
"""force(t, x, v) -> `(..., D)` or one `(D,)` for all [N] at positions `x` and velocities `v` `(..., D)`."""


class Command(NamedTuple):
    """What a policy asks of a plant in one step.

    Attributes:
        x_before: `(*batch, *points, D)` reference position before the step.
        x: `(*batch, *points, D)` reference position after it.
        v_before: `(*batch, *points, O)` reference velocity of the step before; zero in the first.
        v: `(*batch, *points, O)` reference velocity of this step.
        stiffness: `(*batch, *points, Q)` [N/m]; None for a policy without stiffness.
        t: time at the beginning of the step [s].
        dt: time step [s].
    """

    x_before: Tensor
    x: Tensor
    v_before: Tensor
    v: Tensor
    stiffness: Tensor | None
    t: float
    dt: float


class PointMassState(NamedTuple):
    """The state of a `PointMass`, with what caused it.

    Attributes:
        x: `(*batch, *points, D)` position.
        v: `(*batch, *points, D)` velocity.
        acceleration: `(*batch, *points, D)` of the step that led here; zero at the start.
        stiffness: `(*batch, *points, D)` applied in that step, one per axis [N/m]; the policy may have asked for another
            (`Rollout.stiffness`).
        force: `(*batch, *points, D)` external force in that step [N].
    """

    x: Tensor
    v: Tensor
    acceleration: Tensor
    stiffness: Tensor
    force: Tensor


class Plant(Protocol):
    """What a roll-out needs of a plant; all tensors carry `(*batch, *points)` in front, and nothing loops over it."""

    def reset(self, x0: Tensor) -> Any:
        """The state at rest at `x0`."""

    def step(self, state: Any, command: Command) -> Any:
        """The state after one step under a command: a NamedTuple of tensors, `x` and `v` among them (docs/plants.md)."""


class PointMass(Movable):
    """A point mass with viscous damping in an external force field, integrated as in Eq. 29-31.

    Args:
        mass: [kg].
        damping: [N s/m].
        force: external force, evaluated before each step; None for none.

    Raises:
        InvalidArgumentError: a mass that is not positive, or negative damping.
    """

    def __init__(self, mass: float = 1.0, damping: float = 1.0, force: Force | None = None) -> None:
        mass, damping = (
            number(name, n, "a number", lambda _: True) for name, n in (("mass", mass), ("damping", damping))
        )
        if not mass > 0 or not damping >= 0:
            raise InvalidArgumentError(f"mass has to be positive and damping ≥ 0, got {mass} and {damping}")
        self.mass = mass
        self.damping = damping
        self.force = force

    def reset(self, x0: Tensor) -> PointMassState:
        """At rest at `x0`."""
        zero = torch.zeros_like(x0)
        return PointMassState(x0, zero, zero, zero, zero)

    def external(self, t: float, state: PointMassState) -> Tensor:
        """The external force in a state."""
        if self.force is None:
            return torch.zeros_like(state.x)
        return over("force", self.force(t, state.x, state.v), state.x, "(..., D)")

    def advance(self, state: PointMassState, acceleration: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Velocity first, then position with the new velocity (Eq. 29-30)."""
        v = state.v + acceleration * dt
        return state.x + v * dt, v
