"""What a task says about its motion, its search and its looks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from torch import Tensor

from torchds.devices import Movable
from torchds.exploration import Homogeneous
from torchds.optim.functional import Temperature

Convention = Literal["paper", "released"]


class Motion(NamedTuple):
    """Where a motion begins, and for how long it goes on: `rollout(policy, *motion)`.

    Attributes:
        x0: `(*points, D)` the starts.
        n_steps: T.
        dt: time step [s].
    """

    x0: Tensor
    n_steps: int
    dt: float


@dataclass(frozen=True)
class SearchSettings:
    """What a task proposes to whoever searches.

    A size of noise that is None is a share of the imitated motion, as `Homogeneous.relative`, `Gaussian.relative` and
    `TrajectorySpace.relative` have it, so that a task with units of its own needs no constants. The tasks of the paper give
    theirs.

    Attributes:
        n_updates: policy updates.
        n_rollouts: N, roll-outs per update.
        control_weight: r of the control cost r I; it compares parameters with costs, so that only the task can know it.
        mean_speed: of the homogeneous exploration [velocity unit of the task].
        homogeneous: the homogeneous exploration, made with `(policy, mean_speed, mean_stiffness=)`.
        std: of independent noise: on all parameters alike, or on A where b is tied to it [1/s].
        spread: of the exploration along the motion [unit of each output]; None for a share of the motion, as all that
            belongs to it then (see `TrajectorySpace.relative`).
        mean_stiffness: of the noise in each stiffness row [N/m].
        stiffness_spread: of the exploration along the motion, in the stiffness [N/m].
        temperature: the spread of costs that scales the weights.
        decay: of the exploration.
        elite: what the first roll-out of an update is (see `PIBB`).
    """

    n_updates: int = 50
    n_rollouts: int = 10
    control_weight: float = 0.0
    mean_speed: float | None = None
    homogeneous: type[Homogeneous] = Homogeneous
    std: float | None = None
    spread: tuple[float, ...] | None = None
    mean_stiffness: float | None = None
    stiffness_spread: float | None = None
    temperature: Temperature = "range"
    decay: Literal["inverse", "linear", "exponential", "none"] = "inverse"
    elite: Literal["none", "nominal", "best"] = "none"


PAPER_SEARCH = SearchSettings(control_weight=5e-4, mean_speed=0.1, std=0.01, mean_stiffness=0.0)
"""The numbers of section 3.3, from which the tasks of the paper begin."""
PAPER_FLOOR = 1e-6
"""Added to the covariances of the paper's tasks while they are fitted."""


class Regions(NamedTuple):
    """Discs that a motion should stay out of.

    Attributes:
        centres: `(R, D)`.
        radii: `(R,)`.
    """

    centres: Tensor
    radii: Tensor


@dataclass(frozen=True)
class Scene(Movable):
    """What there is to see in a task, for figures.

    Attributes:
        starts: `(S, D)`.
        goal: `(D,)`.
        via_points: sets of `(L, D)` points by name.
        walls: `(W, 2, D)` the ends of each; None without.
        unit: of positions.
        regions: to stay out of; None without.
    """

    starts: Tensor
    goal: Tensor
    via_points: dict[str, Tensor] = field(default_factory=dict)
    unit: str = ""
    walls: Tensor | None = None
    regions: Regions | None = None

    def obstacles(self) -> list[Tensor]:
        """Points `(..., D)` that limits of a figure have to hold, so that walls and regions are seen whole."""
        walls = [] if self.walls is None else [self.walls]
        regions = (
            []
            if self.regions is None
            else [self.regions.centres + side * self.regions.radii[:, None] for side in (-1, 1)]
        )
        return [*walls, *regions]
