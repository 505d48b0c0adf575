"""Pass through via-points on the way to a goal: a human N or P, corrected (section 3.3, appendix A.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import torch
from torch import Tensor

from tasks.base import Task
from tasks.imitation import without_stiffness
from tasks.settings import PAPER_FLOOR, PAPER_SEARCH, Motion, Scene
from torchds import Demonstrations, GMRPolicy, Rollout, costs, load_lasa
from torchds.dmp import DMP
from torchds.errors import InvalidArgumentError


@dataclass(frozen=True, kw_only=True)
class Setup:
    """The constants of one letter.

    Attributes:
        start: where the motion begins.
        via_points: to pass through.
        duration: T dt [s].
        dt: time step [s].
        unit: of positions.
    """

    start: tuple[float, float]
    via_points: tuple[tuple[float, float], ...]
    duration: float
    dt: float
    unit: str


# Start and via-points are not in the paper. Ours lie about one unit beside the motion that the demonstrations give, on
# alternating sides; time is stretched until the motion has about 0.8 units/s, so that its noise of 0.1 is an eighth.
N = Setup(
    start=(-10.8, -11.1),
    via_points=((-10.0, -4.0), (-6.5, -3.0), (-3.5, -8.5), (-0.5, -4.5)),
    duration=40.0,
    dt=0.2,
    unit="4 mm",
)
P = Setup(
    start=(-4.8, -4.9),
    via_points=((-6.0, 0.5), (-1.5, 5.5), (4.5, 7.0), (3.0, 2.0)),
    duration=40.0,
    dt=0.2,
    unit="4 mm",
)

SCALE = 0.25  # LASA millimetres to units
EVERY = 5  # every fifth sample is fitted
ACCELERATION_WEIGHT = 1e-4
N_BASIS = 12  # two weights each are the 24 parameters of four Gaussians
DMP_CONTROL_WEIGHT = 8e-9  # noise that moves the motion as far costs as much as with 5e-4 there


class ViaPoint(Task):
    """Three handwritten letters are imitated, then improved to pass through via-points (section 3.3; Eq. 39).

    The cost is Σ_l min_j |x_l^via − x_j|² + |x^goal − x_T|² + 10⁻⁴ Σ_j |v_j − v_{j−1}|, and a control cost of r = 5·10⁻⁴.
    Other demonstrations should end at the origin, the goal.

    Raises:
        InvalidArgumentError: an unknown shape.
    """

    name = "via_point"
    search = PAPER_SEARCH
    covariance_floor = PAPER_FLOOR
    setups: ClassVar[Mapping[str, Setup]] = {"N": N, "P": P}

    shape: Literal["N", "P"] = "N"
    """Which letter is drawn."""
    system: Literal["gmr", "dmp"] = "gmr"
    """What draws it. gmr: the dynamical system, driven by its state. dmp: a dynamic movement primitive, driven by a phase."""

    def __post_init__(self) -> None:
        if self.system not in ("gmr", "dmp") or (self.system == "dmp" and self.convention != "paper"):
            raise InvalidArgumentError(
                f"system has to be 'gmr', or 'dmp' with convention 'paper', got {self.system!r} and {self.convention!r}"
            )
        if self.system == "dmp":
            self.search = replace(self.search, control_weight=DMP_CONTROL_WEIGHT)
        if self.shape not in self.setups:
            raise InvalidArgumentError(f"shape has to be {' or '.join(map(repr, self.setups))}, got {self.shape!r}")
        self.setup = self.setups[self.shape]
        self.start = torch.tensor(self.setup.start, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = torch.tensor(self.setup.via_points, dtype=torch.float64)

    def default_demonstrations(self) -> Demonstrations:
        """The first three recordings of the letter."""
        return load_lasa(f"{self.shape}Shape", 3, scale=SCALE, duration=self.setup.duration).every(EVERY)

    def policy(self) -> GMRPolicy:
        """The imitated letter."""
        if self.system == "dmp":
            if self.source is None:
                raise InvalidArgumentError(
                    "system 'dmp' is fitted to demonstrations, got a mixture alone; give both, or none"
                )
            return DMP.fit(self.source, N_BASIS, self.goal)
        return without_stiffness(self.mixture, 2, 2, "this task learns no stiffness")

    def motion(self) -> Motion:
        """The motion from the one start."""
        return Motion(self.start, round(self.setup.duration / self.setup.dt), self.setup.dt)

    def judged(self, path: Rollout) -> Tensor:
        """The positions `(*batch, T+1, 2)` that via-points and goal see."""
        return path.x

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration of Eq. 39."""
        x = self.judged(path)
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {"via_points": costs.via_points(x, self.via_points), "goal": costs.goal(x, self.goal), **running}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration term by steps."""
        return {"acceleration": ACCELERATION_WEIGHT * costs.acceleration_steps(path.v)}

    def scene(self) -> Scene:
        """Start, goal and via-points."""
        return Scene(self.start[None], self.goal, {"via-points": self.via_points}, unit=self.setup.unit)
