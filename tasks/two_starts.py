"""One policy, two starts, two sets of via-points: behaviour that depends on the state (section 3.3, appendix A.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from tasks.base import Convention, Motion, Scene, SearchSettings, Task
from tasks.released.base import RELEASED_SEARCH, released_fit, released_plant
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, load_lasa


@dataclass(frozen=True)
class Setup:
    """The constants under one convention, none of which is in the paper.

    Attributes:
        starts: left and right.
        via_points: sets of them; the released ones differ in number.
        n_components: Gaussians of the mixture.
        duration: T dt [s].
        dt: time step [s].
        unit: of positions.
    """

    starts: tuple[tuple[float, float], ...]
    via_points: dict[str, tuple[tuple[float, float], ...]]
    n_components: int
    duration: float
    dt: float
    unit: str


SETUPS = {
    "paper": Setup(
        ((-11.0, -0.5), (11.0, -0.5)),
        {"left": ((-10.0, 5.0), (-5.5, 9.5), (-2.0, 5.0)), "right": ((8.0, 4.5), (5.5, 10.0), (3.0, 4.5))},
        6,
        40.0,
        0.2,
        "4 mm",
    ),
    "released": Setup(
        ((-8.0, 0.0), (8.0, 0.0)),
        {"left": ((-6.0, -3.0), (-4.0, 0.0), (-2.0, 3.0)), "right": ((6.0, 0.0), (5.0, -4.0), (3.0, -4.0), (2.0, 0.0))},
        7,
        11.0,
        0.1,
        "",
    ),
}
SCALE, EVERY = 0.25, 5  # LASA millimetres to units; every fifth sample is fitted
ACCELERATION_WEIGHT = 2e-4


class TwoStarts(Task):
    """An angle and its mirror image are imitated, then each side learns via-points of its own (Eq. 40).

    A roll-out is two trajectories, from the left and from the right start, whose costs are added. Each trajectory passes
    through one of two sets of via-points, whichever is cheaper for it: min_b Σ_l min_j |x_{l,b}^via − x_j|².

    With convention="released", the problem is the one that the authors' program runs, quirks included: a unit point mass
    tracks the reference as in `ViaPoint`; costs are averaged over the starts, not added; by a slip of an index the
    acceleration term is that of the right start alone, and the average halves it. Give `demonstrations` or `mixture`.

    Args:
        demonstrations: see `Task`; they should end at the origin, the goal, from both sides.
        mixture: see `Task`.
        convention: see `Task`.

    Raises:
        InvalidArgumentError: an unknown convention, or the released one without data.
    """

    name = "two_starts"
    conventions = ("paper", "released")

    def __init__(
        self,
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        super().__init__(demonstrations=demonstrations, mixture=mixture, convention=convention)
        self.setup = SETUPS[convention]
        self.starts = torch.tensor(self.setup.starts, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = {
            name: torch.tensor(points, dtype=torch.float64) for name, points in self.setup.via_points.items()
        }
        self.search, self.plant = SearchSettings(n_updates=200, n_rollouts=20), None
        if convention == "released":
            # The optimizer adds the control cost of both starts; half the weight makes it their mean.
            self.search = replace(RELEASED_SEARCH, n_updates=200, n_rollouts=20, control_weight=2.5e-4, elite="best")
            self.plant = released_plant()

    def default_demonstrations(self) -> Demonstrations:
        """Three recorded angles and their mirror images."""
        if self.convention == "released":
            raise self.needs_data()
        angle = load_lasa("Angle", 3, scale=SCALE, duration=self.setup.duration).every(EVERY)
        return angle + angle.mirror(0)

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """Gaussians over position and velocity."""
        fit = released_fit if self.convention == "released" else GaussianMixture.fit
        return fit(demonstrations, self.setup.n_components)

    def policy(self) -> GMRPolicy:
        """The imitated motion, alike on both sides."""
        return GMRPolicy.from_mixture(self.mixture.marginal(0, 4), input_dim=2)

    def motion(self) -> Motion:
        """From both starts."""
        return Motion(self.starts, round(self.setup.duration / self.setup.dt), self.setup.dt)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration of Eq. 40 over both starts."""
        either = torch.stack([costs.via_points(path.x, points) for points in self.via_points.values()])
        via, goal = either.amin(0), costs.goal(path.x, self.goal)  # (*batch, S)
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        if self.plant is None:
            return {"via_points": via.sum(-1), "goal": goal.sum(-1), **running}
        return {"via_points": via.mean(-1), "goal": goal.mean(-1), **running}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration."""
        if self.plant is None:
            return {"acceleration": ACCELERATION_WEIGHT * costs.acceleration_steps(path.v).sum(-2)}
        squared = path.plant.acceleration[..., 1, 1:, :].square().sum(-1)  # of the right start
        return {"acceleration": 0.5 * ACCELERATION_WEIGHT * squared}

    def scene(self) -> Scene:
        """Both starts, the goal and both sets of via-points."""
        sets = {f"via-points, {name}": points for name, points in self.via_points.items()}
        return Scene(self.starts, self.goal, sets, unit=self.setup.unit)
