"""One policy, two starts, two sets of via-points: behaviour that depends on the state (section 3.3, appendix A.2)."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from tasks.base import Convention, Scene, SearchSettings, Task
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, load_lasa, rollout

# The constants that the paper leaves out [units of 4 mm].
STARTS = ((-11.0, -0.5), (11.0, -0.5))
LEFT = ((-10.0, 5.0), (-5.5, 9.5), (-2.0, 5.0))
RIGHT = ((8.0, 4.5), (5.5, 10.0), (3.0, 4.5))
SCALE, DURATION, EVERY = 0.25, 40.0, 5
N_COMPONENTS = 6
DT, N_STEPS = 0.2, 200  # s
ACCELERATION_WEIGHT = 2e-4


class TwoStarts(Task):
    """An angle and its mirror image are imitated, then each side learns via-points of its own (Eq. 40).

    A roll-out is two trajectories, from the left and from the right start, whose costs are added. Each trajectory passes
    through one of two sets of via-points, whichever is cheaper for it: min_b Σ_l min_j |x_{l,b}^via − x_j|².

    Args:
        demonstrations: see `Task`; they should end at the origin, the goal, from both sides.
        mixture: see `Task`.
        convention: see `Task`.
    """

    name = "two_starts"
    search = SearchSettings(n_updates=200, n_rollouts=20, control_weight=5e-4, mean_speed=0.1)

    def __init__(
        self,
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        super().__init__(demonstrations=demonstrations, mixture=mixture, convention=convention)
        self.starts = torch.tensor(STARTS, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = torch.tensor((LEFT, RIGHT), dtype=torch.float64)

    def default_demonstrations(self) -> Demonstrations:
        """Three recorded angles and their mirror images."""
        angle = load_lasa("Angle", 3, scale=SCALE, duration=DURATION).every(EVERY)
        return angle + angle.mirror(0)

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """Six Gaussians over position and velocity."""
        return GaussianMixture.fit(demonstrations, N_COMPONENTS)

    def policy(self) -> GMRPolicy:
        """The imitated motion, alike on both sides."""
        return GMRPolicy.from_mixture(self.mixture, input_dim=2)

    def rollout(self, policy: GMRPolicy) -> Rollout:
        """40 s from both starts."""
        return rollout(policy, self.starts, N_STEPS, DT)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration of Eq. 40, summed over the starts."""
        either = torch.stack([costs.via_points(path.x, points) for points in self.via_points])  # (2, *batch, S)
        return {
            "via_points": either.amin(0).sum(-1),
            "goal": costs.goal(path.x, self.goal).sum(-1),
            "acceleration": ACCELERATION_WEIGHT * costs.acceleration(path.v).sum(-1),
        }

    def scene(self) -> Scene:
        """Both starts, the goal and both sets of via-points."""
        sets = {"via-points, left": self.via_points[0], "via-points, right": self.via_points[1]}
        return Scene(self.starts, self.goal, sets, unit="4 mm")
