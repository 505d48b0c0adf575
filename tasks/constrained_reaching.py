"""Reach a goal in a box on the shortest way around its wall, stable all the time (section 4.3, appendix B)."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from tasks.base import Convention, Motion, Scene, SearchSettings, Task
from tasks.released.base import RELEASED_SEARCH, released_fit, released_plant
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, fit_stable, plants
from torchds.errors import InvalidArgumentError
from torchds.fits import StableFit
from torchds.plants import Command

DURATION, DT = 15.0, 0.1  # s
N_COMPONENTS = 3
SHORTEST = 8.815  # Eq. 41: the length of the shortest path, start - corner - goal
GOAL_WEIGHT, ACCELERATION_WEIGHT = 10.0, 0.01

# The paper gives the shortest length and no geometry. A box around the goal, two wide and open at the top; the start lies
# six units left of the corner that is in the way, as low as makes the way around it exactly that long.
BOX = ((-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0))
CORNER = BOX[0]
START = (-7.0, 1.0 - math.sqrt((SHORTEST - math.hypot(*CORNER)) ** 2 - 36.0))

# The released program: a thick left wall and a thick floor, as (low, high) corners. Between them, for x₂ from −1.5 to 0, is a
# hole, through which the straight line from start to goal (6.32 long) leads.
RELEASED_BLOCKS = (((-2.5, 0.0), (-1.5, 2.0)), ((-2.5, -2.5), (2.5, -1.5)))
RELEASED_START = (-6.0, -2.0)
RELEASED_N_COMPONENTS = 6
RELEASED_ACCELERATION_WEIGHT = 1e-3  # of |a_j|, the same as 0.01 |v_j − v_{j−1}|

# Demonstrations: cubic Bézier curves from around the start to the goal, high over the corner, coming to rest at the end.
OFFSETS = ((-0.6, 0.3), (-0.2, -0.6), (0.5, 0.5), (0.3, -0.2))
CONTROLS = ((-7.5, 2.0), (-0.5, 5.1))
DEMONSTRATED = 12.0  # s


@dataclass(frozen=True)
class Walls:
    """A stop condition: a step that would cross or touch a wall is not taken.

    Args:
        segments: `(W, 2, 2)` the ends of each wall.
    """

    segments: Tensor

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


def _side(p: Tensor, q: Tensor, x: Tensor) -> Tensor:
    """Twice the signed area of the triangle p, q, x."""
    u, w = torch.broadcast_tensors(q - p, x - p)
    return u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]


class WalledMotion(NamedTuple):
    """A plant's `PointMassState`, and the reference position that counts: where it was when the plant met a wall."""

    x: Tensor
    v: Tensor
    acceleration: Tensor
    stiffness: Tensor
    force: Tensor
    held: Tensor


class WalledMass:
    """The released program's tracking point mass among blocks: inside one, it and its reference rest for good.

    The controller goes on pulling, so its acceleration still counts.

    Args:
        blocks: `(W, 2, D)` low and high corners.
    """

    def __init__(self, blocks: Tensor) -> None:
        self.blocks = blocks
        self.free = released_plant()

    def inside(self, x: Tensor) -> Tensor:
        """`(..., 1)` True inside a block, for `x` `(..., D)`."""
        low, high = self.blocks.to(x).unbind(-2)
        x = x.unsqueeze(-2)
        return ((x > low) & (x < high)).all(-1).any(-1, keepdim=True)

    def reset(self, x0: Tensor) -> WalledMotion:
        """At rest at `x0`."""
        return WalledMotion(*self.free.reset(x0), held=x0)

    def step(self, state: WalledMotion, command: Command) -> WalledMotion:
        """One step of the free plant, unless it is stuck."""
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


class ConstrainedReaching(Task):
    """A goal in a box that is open at the top; whoever hits a wall stays there until the end (Eq. 41).

    The cost is 10 |x^goal − x_T|² + 0.01 Σ_j |v_j − v_{j−1}| + Σ_j |v_j| dt − 8.815, and a control cost of r = 10⁻³. The
    motion begins as a stable one, fitted to the demonstrations with three Gaussians, of length 12.5.

    With convention="released", the problem is the one that the authors' program runs, quirks included: a tracking point
    mass as in `ViaPoint`, judged by where it is; two thick walls with a hole between them on the straight line from start to
    goal, which is shorter than what the cost calls the shortest path, so that the cost can fall to about −2.4; six Gaussians
    by EM, without stability; 10⁻³ Σ_j |a_j| for the acceleration. Give `demonstrations` or `mixture`.

    Args:
        condition: of the fit: "seds" as in the paper, or "p-qlf", which has a metric P of its own; the released problem
            has none.
        demonstrations: see `Task`; the goal is the origin wherever they end.
        mixture: see `Task`; taken as it is, stable or not.
        convention: see `Task`.

    Raises:
        InvalidArgumentError: an unknown condition or convention, or the released one without data.
    """

    name = "constrained_reaching"
    conventions = ("paper", "released")
    differentiable = False  # the cost jumps where a motion meets a wall; its gradient does not see the wall coming

    def __init__(
        self,
        condition: Literal["seds", "p-qlf"] = "seds",
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        super().__init__(demonstrations=demonstrations, mixture=mixture, convention=convention)
        if condition not in ("seds", "p-qlf"):
            raise InvalidArgumentError(f"condition has to be 'seds' or 'p-qlf', got {condition!r}")
        self.condition: Literal["seds", "p-qlf"] = condition
        self.start = torch.tensor(START, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        corners = torch.tensor(BOX, dtype=torch.float64)
        self.walls = self.stop = Walls(torch.stack([corners[:-1], corners[1:]], 1))
        self.search = SearchSettings(n_updates=100, control_weight=1e-3, std=0.05)
        if convention == "released":
            blocks = torch.tensor(RELEASED_BLOCKS, dtype=torch.float64)
            self.start, self.plant = torch.tensor(RELEASED_START, dtype=torch.float64), WalledMass(blocks)
            self.walls, self.stop = Walls(torch.cat([_outline(block) for block in blocks])), None
            self.search = replace(RELEASED_SEARCH, control_weight=1e-3, mean_speed=0.04)

    def default_demonstrations(self) -> Demonstrations:
        """Four detours from around the start."""
        if self.convention == "released":
            raise self.needs_data()
        s = 1.0 - (1.0 - torch.linspace(0.0, 1.0, 121, dtype=torch.float64)[:, None]) ** 2  # coming to rest
        tracks = []
        for offset in torch.tensor(OFFSETS, dtype=torch.float64):
            first, second = torch.tensor(CONTROLS, dtype=torch.float64) + 0.5 * offset
            begin = self.start + offset
            tracks.append((1 - s) ** 3 * begin + 3 * s * (1 - s) ** 2 * first + 3 * s**2 * (1 - s) * second)
        return Demonstrations(tracks, dt=DEMONSTRATED / (len(s) - 1))

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """Gaussians over position and velocity, not stable; the paper's policy is another fit."""
        if self.convention == "released":
            return released_fit(demonstrations, RELEASED_N_COMPONENTS)
        return GaussianMixture.fit(demonstrations, N_COMPONENTS)

    @cached_property
    def stable_fit(self) -> StableFit:
        """The fit to the demonstrations."""
        return fit_stable(self.demonstrations, N_COMPONENTS, self.condition, "likelihood", goal=self.goal)

    @property
    def P(self) -> Tensor | None:
        """Of the condition that the policy satisfies; None for the identity."""
        return self.stable_fit.P if self.condition == "p-qlf" and not self._as_it_is else None

    @property
    def _as_it_is(self) -> bool:
        """Whether the policy is that of a mixture, and no stable fit."""
        return self._mixture is not None or self.convention == "released"

    def policy(self) -> GMRPolicy:
        """The imitated detour."""
        if self._as_it_is:
            return GMRPolicy.from_mixture(self.mixture.marginal(0, 4), input_dim=2)
        return copy.deepcopy(self.stable_fit.policy)

    def motion(self) -> Motion:
        """From the one start."""
        return Motion(self.start, round(DURATION / DT), DT)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Goal, acceleration and path length of Eq. 41."""
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {"goal": GOAL_WEIGHT * costs.goal(path.x, self.goal), **running}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration, and the path length beyond the shortest one, spread over the steps."""
        if self.plant is None:
            acceleration = ACCELERATION_WEIGHT * costs.acceleration_steps(path.v)
        else:
            a = path.plant.acceleration[..., 1:, :]
            acceleration = RELEASED_ACCELERATION_WEIGHT * torch.linalg.vector_norm(a, dim=-1)
        return {
            "acceleration": acceleration,
            "path_length": torch.linalg.vector_norm(path.v, dim=-1) * path.dt - SHORTEST / path.v.shape[-2],
        }

    def scene(self) -> Scene:
        """Start, goal and the box."""
        return Scene(self.start[None], self.goal, walls=self.walls.segments)
