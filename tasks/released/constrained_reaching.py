"""Constrained reaching as the authors' program runs it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from tasks.constrained_reaching import ConstrainedReaching
from tasks.released.base import RELEASED_SEARCH, Released, released_plant
from torchds import GMRPolicy, Rollout, Walls, plants
from torchds.devices import Movable
from torchds.errors import InvalidArgumentError
from torchds.plants import Command

# The released program: a thick left wall and a thick floor, as (low, high) corners. Between them, for x₂ from −1.5 to 0, is a
# hole, through which the straight line from start to goal (6.32 long) leads.
BLOCKS = (((-2.5, 0.0), (-1.5, 2.0)), ((-2.5, -2.5), (2.5, -1.5)))
START = (-6.0, -2.0)
ACCELERATION_WEIGHT = 1e-3  # of |a_j|, the same as 0.01 |v_j − v_{j−1}|


class WalledMotion(NamedTuple):
    """A plant's `PointMassState`, and the reference position that counts: where it was when the plant met a wall."""

    x: Tensor
    v: Tensor
    acceleration: Tensor
    stiffness: Tensor
    force: Tensor
    held: Tensor


class WalledMass(Movable):
    """The released program's tracking point mass among blocks: inside one, it and its reference rest for good.

    The controller goes on pulling, so its acceleration still counts.

    Args:
        blocks: `(W, 2, D)` low and high corners.
    """

    def __init__(self, blocks: Tensor) -> None:
        self.blocks = blocks
        self.free = released_plant()

    def inside(self, x: Tensor) -> Tensor:
        """Whether `x` `(..., D)` is inside a block, `(..., 1)`."""
        low, high = self.blocks.to(x).unbind(-2)
        x = x.unsqueeze(-2)
        return ((x > low) & (x < high)).all(-1).any(-1, keepdim=True)

    def reset(self, x0: Tensor) -> WalledMotion:
        """Put the mass at `x0`, at rest."""
        return WalledMotion(*self.free.reset(x0), held=x0)

    def step(self, state: WalledMotion, command: Command) -> WalledMotion:
        """Make one step of the free plant, unless it is stuck."""
        stuck = self.inside(state.x)
        held = torch.where(stuck, state.held, command.x)
        v = command.v.masked_fill(stuck, 0.0)
        free = self.free.step(plants.PointMassState(*state[:5]), command._replace(x=held, v=v))
        x = torch.where(stuck, state.x, free.x)
        return WalledMotion(x, free.v.masked_fill(self.inside(x), 0.0), *free[2:], held=held)


def _outline(block: Tensor) -> Tensor:
    """The four sides `(4, 2, 2)` of a block `(2, 2)`."""
    (x0, y0), (x1, y1) = block.tolist()
    corners = block.new_tensor([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return torch.stack([corners, corners.roll(-1, 0)], 1)


class ReleasedConstrainedReaching(Released, ConstrainedReaching):
    """`ConstrainedReaching` without stability, quirks included.

    A point mass tracks the reference as in `ReleasedViaPoint`, judged by where it is. There are two thick walls with a hole
    between them on the straight line from start to goal, which is shorter than what the cost calls the shortest path, so that
    the cost can fall to about −2.4. Six Gaussians by EM are not stable. The acceleration term is 10⁻³ Σ_j |a_j|.

    Raises:
        InvalidArgumentError: a condition, of which this problem has none.
    """

    name = "constrained_reaching"
    n_components = 6
    search = replace(RELEASED_SEARCH, control_weight=1e-3, mean_speed=0.04)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.condition != "seds":
            raise InvalidArgumentError(
                f"the released problem has no stability condition, got {self.condition!r}; leave it out"
            )
        blocks = torch.tensor(BLOCKS, dtype=torch.float64)
        self.start, self.plant = torch.tensor(START, dtype=torch.float64), WalledMass(blocks)
        self.walls, self.stop = Walls(torch.cat([_outline(block) for block in blocks])), None

    def policy(self) -> GMRPolicy:
        """The imitated motion."""
        return GMRPolicy.from_mixture(self.mixture.marginal(0, 4), input_dim=2)

    def acceleration(self, path: Rollout) -> Tensor:
        """The acceleration term of the plant by steps `(*batch, T)`."""
        return ACCELERATION_WEIGHT * torch.linalg.vector_norm(path.plant.acceleration[..., 1:, :], dim=-1)
