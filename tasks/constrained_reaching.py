"""Reach a goal in a box on the shortest way around its wall, stable all the time (section 4.3, appendix B)."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from tasks.base import Task
from tasks.imitation import without_stiffness
from tasks.settings import PAPER_FLOOR, PAPER_SEARCH, Motion, Scene
from torchds import Demonstrations, GMRPolicy, Rollout, Walls, costs, fit_stable
from torchds.devices import moved
from torchds.errors import InvalidArgumentError
from torchds.fits import StableFit

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


class ConstrainedReaching(Task):
    """A goal in a box that is open at the top; whoever hits a wall stays there until the end (Eq. 41).

    The cost is 10 |x^goal − x_T|² + 0.01 Σ_j |v_j − v_{j−1}| + Σ_j |v_j| dt − 8.815, and a control cost of r = 10⁻³. The
    motion begins as a stable one, fitted to the demonstrations with three Gaussians, of length 12.5.

    The goal is the origin wherever other demonstrations end; a mixture is taken as it is, stable or not.

    Raises:
        InvalidArgumentError: an unknown condition.
    """

    name = "constrained_reaching"
    differentiable = False  # the cost jumps where a motion meets a wall; its gradient does not see the wall coming
    defaults: ClassVar[Mapping[str, Any]] = {"exploration": "stable"}
    n_components = N_COMPONENTS
    covariance_floor = PAPER_FLOOR
    search = replace(PAPER_SEARCH, n_updates=100, control_weight=1e-3, std=0.05)

    condition: Literal["seds", "p-qlf"] = "seds"
    """Stability condition of the fit. seds: as in the paper. p-qlf: with a learned metric P."""

    def __post_init__(self) -> None:
        if self.condition not in ("seds", "p-qlf"):
            raise InvalidArgumentError(f"condition has to be 'seds' or 'p-qlf', got {self.condition!r}")
        self.start = torch.tensor(START, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        corners = torch.tensor(BOX, dtype=torch.float64)
        self.walls = self.stop = Walls(torch.stack([corners[:-1], corners[1:]], 1))

    def default_demonstrations(self) -> Demonstrations:
        """Four detours from around the start."""
        s = 1.0 - (1.0 - torch.linspace(0.0, 1.0, 121, dtype=torch.float64)[:, None]) ** 2  # coming to rest
        tracks = []
        for offset in torch.tensor(OFFSETS, dtype=torch.float64):
            first, second = torch.tensor(CONTROLS, dtype=torch.float64) + 0.5 * offset
            begin = torch.tensor(START, dtype=torch.float64) + offset
            tracks.append((1 - s) ** 3 * begin + 3 * s * (1 - s) ** 2 * first + 3 * s**2 * (1 - s) * second)
        return Demonstrations(tracks, dt=DEMONSTRATED / (len(s) - 1))

    @cached_property
    def stable_fit(self) -> StableFit:
        """The fit to the demonstrations."""
        fit = fit_stable(self.demonstrations, N_COMPONENTS, self.condition, "likelihood", goal=self.goal)
        return moved(fit, *self.place)

    @property
    def P(self) -> Tensor | None:
        """The matrix in the condition that the policy satisfies; None for the identity."""
        return self.stable_fit.P if self.condition == "p-qlf" and self.given_mixture is None else None

    def policy(self) -> GMRPolicy:
        """The imitated detour."""
        if self.given_mixture is not None:
            return without_stiffness(self.mixture, 2, 2, "this task learns no stiffness")
        return copy.deepcopy(self.stable_fit.policy)

    def motion(self) -> Motion:
        """The motion from the one start."""
        return Motion(self.start, round(DURATION / DT), DT)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Goal, acceleration and path length of Eq. 41."""
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {"goal": GOAL_WEIGHT * costs.goal(path.x, self.goal), **running}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration, and the path length beyond the shortest one, spread over the steps."""
        return {
            "acceleration": self.acceleration(path),
            "path_length": torch.linalg.vector_norm(path.v, dim=-1) * path.dt - SHORTEST / path.v.shape[-2],
        }

    def acceleration(self, path: Rollout) -> Tensor:
        """The acceleration term by steps `(*batch, T)`."""
        return ACCELERATION_WEIGHT * costs.acceleration_steps(path.v)

    def scene(self) -> Scene:
        """Start, goal and the box."""
        return Scene(self.start[None], self.goal, walls=self.walls.segments)
