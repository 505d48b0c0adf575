"""Reach a goal in a box on the shortest way around its wall, stable all the time (section 4.3, appendix B)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from tasks.base import Convention, Scene, SearchSettings, Task
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, rollout

DURATION, DT = 15.0, 0.1  # s
N_COMPONENTS = 3
SHORTEST = 8.815  # Eq. 41: the length of the shortest path, start - corner - goal
GOAL_WEIGHT, ACCELERATION_WEIGHT = 10.0, 0.01

# The paper gives the shortest length and no geometry. A box around the goal, two wide and open at the top; the start lies
# six units left of the corner that is in the way, as low as makes the way around it exactly that long.
BOX = ((-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0))
CORNER = BOX[0]
START = (-7.0, 1.0 - math.sqrt((SHORTEST - math.hypot(*CORNER)) ** 2 - 36.0))

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


class ConstrainedReaching(Task):
    """A goal in a box that is open at the top; whoever hits a wall stays there until the end (Eq. 41).

    The cost is 10 |x^goal − x_T|² + 0.01 Σ_j |v_j − v_{j−1}| + Σ_j |v_j| dt − 8.815, and a control cost of r = 10⁻³: zero
    would be the shortest way there, in no time. The imitated motion is a stable one (SEDS) of length 12.5.

    Only convention="paper" is there. The released program's box has a hole in its wall and a preset that leaves SEDS off.

    Args:
        demonstrations: see `Task`; they have to end at the origin, the goal.
        mixture: see `Task`; gives the gating, b is dropped and A has to be stable.
        convention: see `Task`.

    Raises:
        InvalidArgumentError: an unknown convention.
    """

    name = "constrained_reaching"

    def __init__(
        self,
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        super().__init__(demonstrations=demonstrations, mixture=mixture, convention=convention)
        self.start = torch.tensor(START, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        corners = torch.tensor(BOX, dtype=torch.float64)
        self.walls = Walls(torch.stack([corners[:-1], corners[1:]], 1))
        self.search = SearchSettings(n_updates=100, control_weight=1e-3)

    def default_demonstrations(self) -> Demonstrations:
        """Four detours from around the start."""
        s = 1.0 - (1.0 - torch.linspace(0.0, 1.0, 121, dtype=torch.float64)[:, None]) ** 2  # coming to rest
        tracks = []
        for offset in torch.tensor(OFFSETS, dtype=torch.float64):
            first, second = torch.tensor(CONTROLS, dtype=torch.float64) + 0.5 * offset
            begin = self.start + offset
            tracks.append((1 - s) ** 3 * begin + 3 * s * (1 - s) ** 2 * first + 3 * s**2 * (1 - s) * second)
        return Demonstrations(tracks, dt=DEMONSTRATED / (len(s) - 1))
