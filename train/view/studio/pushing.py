"""A point mass that follows a policy while somebody pulls at it, one moment after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from torchds import GMRPolicy
from torchds.forces import SpringForce
from torchds.impedance import ImpedanceControlled
from torchds.moments import advance, begin, seen
from torchds.passive import PassiveControlled
from torchds.plants import Plant, PointMass

Execution = Literal["open", "closed", "passive"]

DT = 0.01  # s
MASS = 1.0  # kg
HAND = 60.0  # N/m, of the spring between hand and mass
TRAIL = 150  # steps that are shown


class Pushed:
    """The mass, from rest at the start; its time is that of whoever calls `go_on`.

    Args:
        policy: of the motion, with a stiffness or without.
        start: `(2,)`.
        execution: the policy sees its own reference (open), the mass under impedance control (closed), or the mass under the
            passive controller.
        stiffness: where the policy has none [N/m].
        seconds: after which the reference of the open loop rests.

    Attributes:
        hand: `(2,)` where the hand is that pulls; None where there is none.
        applied: stiffness in the last step, of each axis [N/m].
    """

    def __init__(
        self,
        policy: GMRPolicy,
        start: Tensor,
        execution: Execution = "open",
        stiffness: float = 200.0,
        seconds: float = math.inf,
    ) -> None:
        self.policy, self.feedback = policy, execution != "open"
        self.seconds = math.inf if self.feedback else seconds
        mass = PointMass(MASS, 0.0, self.pull)
        constant = None if policy.stiffness_dim else stiffness
        self.plant: Plant = ImpedanceControlled(mass, constant)
        if execution == "passive":
            damping = None if constant is None else 2 * (stiffness * MASS) ** 0.5  # critical, as with the spring
            self.plant = PassiveControlled(mass, damping)
        self.hand: Tensor | None = None
        self.until = math.inf  # when the hand lets go by itself
        self.now = begin(start.to(policy.A), policy.output_dim, plant=self.plant)
        self.t = 0.0
        self.trail: list[Tensor] = []

    def pull(self, t: float, x: Tensor, v: Tensor) -> Tensor:
        """The force of the hand [N]."""
        return torch.zeros_like(x) if self.hand is None else SpringForce(self.hand, HAND)(t, x, v)

    @torch.no_grad()
    def go_on(self, seconds: float) -> None:
        """Let the time go on by about this much."""
        for _ in range(max(1, round(seconds / DT))):
            if self.t >= self.until:
                self.hold(None)
            x = seen(self.now, self.plant, self.t, DT) if self.feedback else self.now.x
            v, s = self.policy(x), self.policy.stiffness(x) if self.policy.stiffness_dim else None
            if self.t >= self.seconds:
                v = torch.zeros_like(v)
            self.now = advance(self.now, v, s, self.t, DT, plant=self.plant, feedback=self.feedback)
            self.t += DT
            self.trail = [*self.trail[1 - TRAIL :], self.at]

    def hold(self, hand: Tensor | None, seconds: float = math.inf) -> None:
        """Let the hand pull from here `(2,)` for some time, or let go."""
        self.hand, self.until = hand, self.t + seconds

    @property
    def at(self) -> Tensor:
        """`(2,)` where the mass is."""
        x: Tensor = self.now.plant.x
        return x

    @property
    def reference(self) -> Tensor:
        """`(2,)` where it should be."""
        return self.now.x

    @property
    def applied(self) -> Sequence[float]:
        """The stiffness in the last step, of each axis [N/m]."""
        values: list[float] = self.now.plant.stiffness.tolist()
        return values

    @property
    def lost(self) -> bool:
        """Whether it is nowhere any more."""
        return not bool(self.at.isfinite().all())
