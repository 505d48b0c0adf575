"""A point mass among walls."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchds.devices import Movable
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled
from torchds.plants import Command
from torchds.stops import Walls


class WalledState(NamedTuple):
    """What is the same in the states of all point masses (`torchds.plants.PointMassState`), and whether a wall holds the mass.

    Attributes:
        held: `(*batch, *points, 1)` True from the step on that was not taken.
    """

    x: Tensor
    v: Tensor
    acceleration: Tensor
    stiffness: Tensor
    force: Tensor
    held: Tensor


class Walled(Movable):
    """A point mass that rests for good where it met a wall; its controller goes on pulling, and its reference goes its way.

    Args:
        plant: the mass with its controller, which knows place and speed alone: without a tank, and without a limit on the
            rate of the stiffness.
        walls: a step of the mass that would meet one is not taken.
    """

    def __init__(self, plant: ImpedanceControlled | PassiveControlled, walls: Walls) -> None:
        self.plant, self.walls = plant, walls

    def reset(self, x0: Tensor) -> WalledState:
        """At rest at `x0`."""
        return WalledState(*self.plant.reset(x0)[:5], held=torch.zeros_like(x0[..., :1], dtype=torch.bool))

    def step(self, state: WalledState, command: Command) -> WalledState:
        """One step of the mass, unless it would meet a wall or did before."""
        before = self.plant.reset(state.x)._replace(v=state.v)
        after = self.plant.step(before, command)  # type: ignore[arg-type]  # each makes the state that it takes
        held = state.held | self.walls(state.x, after.x).unsqueeze(-1)
        x = torch.where(held, state.x, after.x)
        v, acceleration = (part.masked_fill(held, 0.0) for part in (after.v, after.acceleration))
        return WalledState(x, v, acceleration, after.stiffness, after.force, held)
