"""One policy, two starts, two sets of via-points: behaviour that depends on the state (section 3.3, appendix A.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from tasks.base import Task
from tasks.imitation import without_stiffness
from tasks.settings import PAPER_FLOOR, PAPER_SEARCH, Motion, Scene
from torchds import Demonstrations, GMRPolicy, Rollout, costs, load_lasa


@dataclass(frozen=True, kw_only=True)
class Setup:
    """The constants of the problem, none of which is in the paper.

    Attributes:
        starts: left and right.
        via_points: sets of them; the released ones differ in number.
        duration: T dt [s].
        dt: time step [s].
        unit: of positions.
    """

    starts: tuple[tuple[float, float], ...]
    via_points: dict[str, tuple[tuple[float, float], ...]]
    duration: float
    dt: float
    unit: str


PAPER = Setup(
    starts=((-11.0, -0.5), (11.0, -0.5)),
    via_points={"left": ((-10.0, 5.0), (-5.5, 9.5), (-2.0, 5.0)), "right": ((8.0, 4.5), (5.5, 10.0), (3.0, 4.5))},
    duration=40.0,
    dt=0.2,
    unit="4 mm",
)
SCALE, EVERY = 0.25, 5  # LASA millimetres to units; every fifth sample is fitted
ACCELERATION_WEIGHT = 2e-4


class TwoStarts(Task):
    """An angle and its mirror image are imitated, then each side learns via-points of its own (Eq. 40).

    A roll-out is two trajectories, from the left and from the right start, whose costs are added. Each trajectory passes
    through one of two sets of via-points, whichever is cheaper for it: min_b Σ_l min_j |x_{l,b}^via − x_j|².

    Other demonstrations should end at the origin, the goal, from both sides.
    """

    name = "two_starts"
    n_components = 6
    covariance_floor = PAPER_FLOOR
    search = replace(PAPER_SEARCH, n_updates=200, n_rollouts=20)
    setup: ClassVar[Setup] = PAPER

    def __post_init__(self) -> None:
        self.starts = torch.tensor(self.setup.starts, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = {
            name: torch.tensor(points, dtype=torch.float64) for name, points in self.setup.via_points.items()
        }

    def default_demonstrations(self) -> Demonstrations:
        """Three recorded angles and their mirror images."""
        angle = load_lasa("Angle", 3, scale=SCALE, duration=self.setup.duration).every(EVERY)
        return angle + angle.mirror(0)

    def policy(self) -> GMRPolicy:
        """The imitated motion, alike on both sides."""
        return without_stiffness(self.mixture, 2, 2, "this task learns no stiffness")

    def motion(self) -> Motion:
        """The motion from both starts."""
        return Motion(self.starts, round(self.setup.duration / self.setup.dt), self.setup.dt)

    def over_starts(self, value: Tensor) -> Tensor:
        """What a term `(*batch, S)` costs over both starts `(*batch)`."""
        return value.sum(-1)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration of Eq. 40 over both starts."""
        either = torch.stack([costs.via_points(path.x, points) for points in self.via_points.values()])
        return {
            "via_points": self.over_starts(either.amin(0)),
            "goal": self.over_starts(costs.goal(path.x, self.goal)),
            **{name: steps.sum(-1) for name, steps in self.running_costs(path).items()},
        }

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration term by steps."""
        return {"acceleration": ACCELERATION_WEIGHT * costs.acceleration_steps(path.v).sum(-2)}

    def scene(self) -> Scene:
        """Both starts, the goal and both sets of via-points."""
        sets = {f"via-points, {name}": points for name, points in self.via_points.items()}
        return Scene(self.starts, self.goal, sets, unit=self.setup.unit)
