"""Pass through via-points on the way to a goal: a human N or P, corrected (section 3.3, appendix A.1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from tasks.base import Convention, Scene, SearchSettings, Task
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, load_lasa, rollout
from torchds.errors import InvalidArgumentError


@dataclass(frozen=True)
class Setup:
    """The constants that the paper leaves out: motion, start and via-points [units of 4 mm]."""

    motion: str
    start: tuple[float, float]
    via_points: tuple[tuple[float, float], ...]


# The via-points lie about one unit beside the motion that the demonstrations give, on alternating sides.
SETUPS = {
    "N": Setup("NShape", (-10.8, -11.1), ((-10.0, -4.0), (-6.5, -3.0), (-3.5, -8.5), (-0.5, -4.5))),
    "P": Setup("PShape", (-4.8, -4.9), ((-6.0, 0.5), (-1.5, 5.5), (4.5, 7.0), (3.0, 2.0))),
}
SCALE = 0.25  # LASA millimetres to units
DURATION = 40.0  # s, to which each demonstration is stretched: the motion then has about 0.8 units/s
EVERY = 5  # every fifth sample is fitted
N_COMPONENTS = 4
DT = 0.2  # s
N_STEPS = 200
ACCELERATION_WEIGHT = 1e-4


class ViaPoint(Task):
    """Three handwritten letters are imitated, then improved to pass through via-points (Eq. 39).

    The cost is Σ_l min_j |x_l^via − x_j|² + |x^goal − x_T|² + 10⁻⁴ Σ_j |v_j − v_{j−1}|, and a control cost of r = 5·10⁻⁴.

    Args:
        shape: the letter, "N" or "P".
        demonstrations: see `Task`; they should end at the origin, the goal.
        mixture: see `Task`.
        convention: see `Task`.

    Raises:
        InvalidArgumentError: an unknown shape or convention.
    """

    name = "via_point"
    search = SearchSettings(n_updates=50, n_rollouts=10, control_weight=5e-4, mean_speed=0.1)

    def __init__(
        self,
        shape: Literal["N", "P"] = "N",
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        super().__init__(demonstrations=demonstrations, mixture=mixture, convention=convention)
        if shape not in SETUPS:
            raise InvalidArgumentError(f"shape has to be {' or '.join(map(repr, SETUPS))}, got {shape!r}")
        self.setup = SETUPS[shape]
        self.start = torch.tensor(self.setup.start, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = torch.tensor(self.setup.via_points, dtype=torch.float64)

    def default_demonstrations(self) -> Demonstrations:
        """The first three recordings of the letter."""
        return load_lasa(self.setup.motion, 3, scale=SCALE, duration=DURATION).every(EVERY)

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """Four Gaussians over position and velocity."""
        return GaussianMixture.fit(demonstrations, N_COMPONENTS)

    def policy(self) -> GMRPolicy:
        """The imitated letter."""
        return GMRPolicy.from_mixture(self.mixture, input_dim=2)

    def rollout(self, policy: GMRPolicy) -> Rollout:
        """40 s from the start."""
        return rollout(policy, self.start, N_STEPS, DT)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration of Eq. 39."""
        return {
            "via_points": costs.via_points(path.x, self.via_points),
            "goal": costs.goal(path.x, self.goal),
            "acceleration": ACCELERATION_WEIGHT * costs.acceleration(path.v),
        }

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration."""
        return {"acceleration": ACCELERATION_WEIGHT * costs.acceleration_steps(path.v)}

    def scene(self) -> Scene:
        """Start, goal and via-points."""
        return Scene(self.start[None], self.goal, {"via-points": self.via_points}, unit="4 mm")
