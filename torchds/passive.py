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
from torchds.disturbances import Disturbance
from torchds.errors import InvalidArgumentError
from torchds.plants import Command, PointMass


class PassiveState(NamedTuple):
    """The state of a point mass under `PassiveControlled`, with what caused it.

    Attributes:
        x: `(*batch, *points, D)` position.
        v: `(*batch, *points, D)` velocity.
        acceleration: `(*batch, *points, D)` of the step that led here; zero at the start.
        stiffness: `(*batch, *points, D)` of the policy, of which the damping was made [N/m]: along the field first,
            then across it; zero where the damping is constant, since there is no spring.
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
        along: λ₁, damping and drive along the field [N s/m]; with a large one the velocity is that of the field. If None, the
            policy's stiffness rows s say both, λ = 2 √(s m) as in Eq. 33: the first one λ₁, the last one λ₂.
        across: λ₂, damping across the field [N s/m]; `along` if None.
        tank: energy in the tank at the start [J]; None for no tank.
        capacity: largest energy in the tank [J].
        low: smallest stiffness of the policy's that is applied [N/m].
        high: largest stiffness of the policy's that is applied [N/m].
        disturbance: what the controller measures wrongly, and how the point mass is pushed; None for a plant without noise.

    Raises:
        InvalidArgumentError: a damping below zero, `across` without `along`, a tank that is negative or larger than its
            capacity, bounds that are no interval; from a roll-out, a policy without stiffness where `along` is None, or of
            fewer velocities than the plant has axes.
    """

    def __init__(
        self,
        plant: PointMass,
        along: float | None = 20.0,
        across: float | None = None,
        *,
        tank: float | None = None,
        capacity: float = math.inf,
        low: float = 0.0,
        high: float = math.inf,
        disturbance: Disturbance | None = None,
    ) -> None:
        if along is None and across is not None:
            raise InvalidArgumentError(f"across={across} needs along=; without both the policy's stiffness says them")
        for name, value in (("along", along), ("across", across)):
            if value is not None:
                number(name, value, "finite and at least 0", lambda damping: 0 <= damping < math.inf)
        if tank is not None and not 0 <= tank <= capacity:
            raise InvalidArgumentError(f"tank has to be between 0 and capacity={capacity}, got {tank}")
        if not 0 <= low <= high:
            raise InvalidArgumentError(f"low and high have to be 0 ≤ low ≤ high, got low={low} and high={high}")
        self.plant, self.along, self.across = plant, along, along if across is None else across
        self.tank, self.capacity, self.low, self.high = tank, capacity, low, high
        self.disturbance = disturbance

    def measured(self, state: PassiveState, t: float, dt: float) -> Tensor:
        """Where the point mass seems to be `(*batch, *points, D)`, which is what the policy sees."""
        return state.x if self.disturbance is None else state.x + self.disturbance.at(t, dt, state.x).position

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
        damping, stiffness = self._damping(state.x, command.stiffness)
        felt = force
        if self.disturbance is not None:  # the damper takes what it measures
            chance = self.disturbance.at(command.t, dt, state.x)
            along = (e * chance.velocity).sum(-1, keepdim=True) * e
            force = force + chance.force
            felt = force - damping[0] * along - damping[1] * (chance.velocity - along)
        drive = damping[0] * field
        v = self._velocity(state.v, felt + drive, e, damping, dt)
        tank = state.tank
        if self.tank is not None:
            left = tank + dt * (_taken(v, e, damping) - (drive * v).sum(-1, keepdim=True))
            still = self._velocity(state.v, felt, e, damping, dt)
            enough = left >= 0
            v = torch.where(enough, v, still)
            tank = torch.where(enough, left, tank + dt * _taken(still, e, damping)).clamp_max(self.capacity)
        acceleration = (v - state.v) / dt
        return PassiveState(state.x + v * dt, v, acceleration, stiffness, force, tank)

    def _damping(self, x: Tensor, asked: Tensor | None) -> tuple[tuple[Tensor, Tensor], Tensor]:
        """λ₁ and λ₂ `(..., 1)`, and the stiffness `(..., D)` that they are made of."""
        if self.along is not None and self.across is not None:
            return (x.new_tensor(self.along), x.new_tensor(self.across)), torch.zeros_like(x)
        if asked is None:
            raise InvalidArgumentError("a policy without stiffness says no damping; give PassiveControlled(along=)")
        s = asked.clamp(self.low, self.high)
        along, across = (2 * (part * self.plant.mass).sqrt() for part in (s[..., :1], s[..., -1:]))
        return (along, across), torch.cat([s[..., :1], s[..., -1:].expand(*x.shape[:-1], x.shape[-1] - 1)], -1)

    def _velocity(self, v: Tensor, force: Tensor, e: Tensor, damping: tuple[Tensor, Tensor], dt: float) -> Tensor:
        """(m + dt (d + D))⁻¹ (m v + dt F), D having eigenvalue λ₁ along `e` and λ₂ across."""
        m, d = self.plant.mass, self.plant.damping
        pushed = m * v + dt * force
        along = (e * pushed).sum(-1, keepdim=True) * e
        return (pushed - along) / (m + dt * (d + damping[1])) + along / (m + dt * (d + damping[0]))


def _taken(v: Tensor, e: Tensor, damping: tuple[Tensor, Tensor]) -> Tensor:
    """vᵀ D v, the power that the damper takes `(..., 1)` [W]."""
    along = (e * v).sum(-1, keepdim=True).square()
    return damping[1] * ((v * v).sum(-1, keepdim=True) - along) + damping[0] * along
