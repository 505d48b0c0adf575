"""Pass through via-points on the way to a goal: a human N or P, corrected (section 3.3, appendix A.1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from tasks.base import Convention, Motion, Scene, SearchSettings, Task
from tasks.released.base import RELEASED_SEARCH, released_fit, released_plant
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, load_lasa
from torchds.errors import InvalidArgumentError


@dataclass(frozen=True)
class Setup:
    """The constants of one letter under one convention.

    Attributes:
        motion: LASA name of the demonstrations; None if the user has to bring them.
        start: where the motion begins.
        via_points: to pass through.
        duration: T dt [s].
        dt: time step [s].
        unit: of positions.
        costed: whose position the via-points and the goal see, "reference" or "plant".
    """

    motion: str | None
    start: tuple[float, float]
    via_points: tuple[tuple[float, float], ...]
    duration: float
    dt: float
    unit: str
    costed: Literal["reference", "plant"] = "reference"


# Start and via-points are not in the paper. Ours lie about one unit beside the motion that the demonstrations give, on
# alternating sides; time is stretched until the motion has about 0.8 units/s, so that its noise of 0.1 is an eighth.
N_PAPER = Setup("NShape", (-10.8, -11.1), ((-10.0, -4.0), (-6.5, -3.0), (-3.5, -8.5), (-0.5, -4.5)), 40.0, 0.2, "4 mm")
P_PAPER = Setup("PShape", (-4.8, -4.9), ((-6.0, 0.5), (-1.5, 5.5), (4.5, 7.0), (3.0, 2.0)), 40.0, 0.2, "4 mm")
# The authors' program: the N is judged by where the plant is, the P by its reference.
N_RELEASED = Setup(None, (-130.0, -100.0), ((-120.0, -10.0), (-60.0, -40.0), (-30.0, -110.0)), 12.0, 0.1, "mm", "plant")
P_RELEASED = Setup(None, (-40.0, -20.0), ((-45.0, 20.0), (-10.0, 30.0), (10.0, 15.0)), 15.0, 0.1, "mm")
SETUPS = {"paper": {"N": N_PAPER, "P": P_PAPER}, "released": {"N": N_RELEASED, "P": P_RELEASED}}

SCALE = 0.25  # LASA millimetres to units
EVERY = 5  # every fifth sample is fitted
N_COMPONENTS = 4
ACCELERATION_WEIGHT = 1e-4


class ViaPoint(Task):
    """Three handwritten letters are imitated, then improved to pass through via-points (Eq. 39).

    The cost is Σ_l min_j |x_l^via − x_j|² + |x^goal − x_T|² + 10⁻⁴ Σ_j |v_j − v_{j−1}|, and a control cost of r = 5·10⁻⁴.

    With convention="released", the problem is the one that the authors' program runs, quirks included: a unit point mass
    with unit damping tracks the reference with the constant stiffness 10 (explicit controller); the N is costed at the
    plant's positions, the P at the reference's; the acceleration term is 10⁻⁴ Σ_j |a_j|² of the plant in both; the
    exploration is a tenth of the local speed, its standard deviation falls linearly, and the temperature uses the median.
    Its demonstrations are not part of this project: give `demonstrations` or `mixture`.

    Args:
        shape: the letter, "N" or "P".
        demonstrations: see `Task`; they should end at the origin, the goal.
        mixture: see `Task`.
        convention: see `Task`.

    Raises:
        InvalidArgumentError: an unknown shape or convention, or the released one without data.
    """

    name = "via_point"
    conventions = ("paper", "released")

    def __init__(
        self,
        shape: Literal["N", "P"] = "N",
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        super().__init__(demonstrations=demonstrations, mixture=mixture, convention=convention)
        if shape not in SETUPS[convention]:
            raise InvalidArgumentError(f"shape has to be {' or '.join(map(repr, SETUPS[convention]))}, got {shape!r}")
        self.setup = SETUPS[convention][shape]
        self.start = torch.tensor(self.setup.start, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = torch.tensor(self.setup.via_points, dtype=torch.float64)
        self.search = RELEASED_SEARCH if convention == "released" else SearchSettings()
        self.plant = released_plant() if convention == "released" else None

    def default_demonstrations(self) -> Demonstrations:
        """The first three recordings of the letter."""
        if self.setup.motion is None:
            raise self.needs_data()
        return load_lasa(self.setup.motion, 3, scale=SCALE, duration=self.setup.duration).every(EVERY)

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """Four Gaussians over position and velocity."""
        if self.convention == "released":
            return released_fit(demonstrations, N_COMPONENTS)
        return GaussianMixture.fit(demonstrations, N_COMPONENTS)

    def policy(self) -> GMRPolicy:
        """The imitated letter."""
        return GMRPolicy.from_mixture(self.mixture.marginal(0, 4), input_dim=2)

    def motion(self) -> Motion:
        """From the one start."""
        return Motion(self.start, round(self.setup.duration / self.setup.dt), self.setup.dt)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration of Eq. 39."""
        x = path.x if self.setup.costed == "plant" else path.reference
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {"via_points": costs.via_points(x, self.via_points), "goal": costs.goal(x, self.goal), **running}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration."""
        if self.plant is None:
            return {"acceleration": ACCELERATION_WEIGHT * costs.acceleration_steps(path.v)}
        return {"acceleration": ACCELERATION_WEIGHT * path.plant.acceleration[..., 1:, :].square().sum(-1)}

    def scene(self) -> Scene:
        """Start, goal and via-points."""
        return Scene(self.start[None], self.goal, {"via-points": self.via_points}, unit=self.setup.unit)
