r"""The passive velocity controller of Kronander and Billard (2016), the paper's [45]: a damper shaped along the field.

.. math:: u = λ_1 f(x) - D(x) \dot x = -D(x) (\dot x - f(x)), \qquad D = λ_2 I + (λ_1 - λ_2) e e^T, \quad e = f / |f|.

There is no spring: a push is not undone, the motion goes on from where it ends. What the damper takes is energy taken, so the
robot is passive but for what λ₁ f puts in. That is bounded for a field that is the gradient of a potential; for any
other, an energy tank bounds it: it is filled by what the damper takes, and the field drives only while there is some in it.

Stability: stable.

Example:
    >>> import torch, torchds
    >>> eye = torch.eye(2, dtype=torch.float64)[None]
    >>> policy = torchds.GMRPolicy(torch.ones(1), eye[:, 0], eye, -eye, torch.zeros(1, 2))
    >>> plant = torchds.passive.PassiveControlled(torchds.plants.PointMass(), along=40.0)
    >>> path = torchds.rollout(policy, torch.ones(2), 500, 0.02, plant=plant, feedback=True)
    >>> bool(path.x[-1].norm() < 1e-3)
    True
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchds.arrays import number
from torchds.errors import InvalidArgumentError
from torchds.plants import Command, PointMass


class PassiveState(NamedTuple):
    """The state of a point mass under `PassiveControlled`, with what caused it.

    Attributes:
        x: `(*batch, *points, D)` position.
        v: `(*batch, *points, D)` velocity.
        acceleration: `(*batch, *points, D)` of the step that led here; zero at the start.
        stiffness: `(*batch, *points, D)` zero, since there is no spring.
        force: `(*batch, *points, D)` external force in that step [N].
        tank: `(*batch, *points, 1)` energy in the tank [J]; zero without one.
    """

    x: Tensor
    v: Tensor
    acceleration: Tensor
    stiffness: Tensor
    force: Tensor
    tank: Tensor


class PassiveControlled:
    r"""A point mass under the passive controller, itself a plant, for `torchds.rollout(..., feedback=True)`.

    The velocity at the end of a step is that of implicit Euler, (m + dt (d + D)) v' = m v + dt (λ₁ f + F), which takes as
    much energy as the continuous damper or more, with any time step.

    Args:
        plant: the point mass.
        along: λ₁, damping and drive along the field [N s/m]; with a large one the velocity is that of the field.
        across: λ₂, damping across the field [N s/m]; `along` if None.
        tank: energy in the tank at the start [J]; None for no tank.
        capacity: largest energy in the tank [J].

    Raises:
        InvalidArgumentError: a damping below zero, a tank that is negative or larger than its capacity; from a roll-out, a
            policy of fewer velocities than the plant has axes.
    """

    def __init__(
        self,
        plant: PointMass,
        along: float = 20.0,
        across: float | None = None,
        *,
        tank: float | None = None,
        capacity: float = math.inf,
    ) -> None:
        self.plant = plant
        self.along = number("along", along, "finite and at least 0", lambda value: 0 <= value < math.inf)
        across = self.along if across is None else across
        self.across = number("across", across, "finite and at least 0", lambda value: 0 <= value < math.inf)
        if tank is not None and not 0 <= tank <= capacity:
            raise InvalidArgumentError(f"tank has to be between 0 and capacity={capacity}, got {tank}")
        self.tank, self.capacity = tank, capacity

    def reset(self, x0: Tensor) -> PassiveState:
        """At rest at `x0`."""
        return PassiveState(*self.plant.reset(x0), x0.new_full((*x0.shape[:-1], 1), self.tank or 0.0))

    def step(self, state: PassiveState, command: Command) -> PassiveState:
        """One step; the external force is taken at the state before it."""
        D = state.x.shape[-1]
        if command.v.shape[-1] < D:
            raise InvalidArgumentError(f"{D} axes need as many velocities, got {command.v.shape[-1]}")
        field, dt = command.v[..., :D], command.dt
        speed = torch.linalg.vector_norm(field, dim=-1, keepdim=True)
        e = field / speed.clamp_min(torch.finfo(speed.dtype).tiny)  # zero where the field is: D = λ₂ I there
        force = self.plant.external(command.t, state)  # type: ignore[arg-type]  # x and v are what it looks at
        drive = self.along * field
        v = self._velocity(state.v, force + drive, e, dt)
        tank = state.tank
        if self.tank is not None:
            spent = tank + dt * (self._taken(v, e) - (drive * v).sum(-1, keepdim=True))
            still = self._velocity(state.v, force, e, dt)
            enough = spent >= 0
            v = torch.where(enough, v, still)
            tank = torch.where(enough, spent, tank + dt * self._taken(still, e)).clamp_max(self.capacity)
        acceleration = (v - state.v) / dt
        return PassiveState(state.x + v * dt, v, acceleration, torch.zeros_like(v), force, tank)

    def _velocity(self, v: Tensor, force: Tensor, e: Tensor, dt: float) -> Tensor:
        """(m + dt (d + D))⁻¹ (m v + dt F), D having eigenvalue λ₁ along `e` and λ₂ across."""
        m, d = self.plant.mass, self.plant.damping
        pushed = m * v + dt * force
        along = (e * pushed).sum(-1, keepdim=True) * e
        return (pushed - along) / (m + dt * (d + self.across)) + along / (m + dt * (d + self.along))

    def _taken(self, v: Tensor, e: Tensor) -> Tensor:
        """vᵀ D v, the power that the damper takes `(..., 1)` [W]."""
        along = (e * v).sum(-1, keepdim=True).square()
        return self.across * ((v * v).sum(-1, keepdim=True) - along) + self.along * along
