"""A drawn problem as a task."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar, cast

import torch
from torch import Tensor

from tasks.base import Task
from tasks.imitation import with_constant_stiffness, with_stiffness, without_stiffness
from tasks.loading import absolute, short
from tasks.settings import Motion, Regions, Scene
from tasks.sketch.problem import Problem
from tasks.sketch.walled import Walled
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, Walls, costs, fit_stable
from torchds.devices import moved
from torchds.fits import Condition, StableFit
from torchds.forces import ConstantForce, DivergentForce
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled
from torchds.plants import Force, PointMass

STARTS, TOLERANCE = 3, 1e-4  # of the fit; the likelihood of what hands draw is that of the usual ones to three digits
RANGE = 100.0  # how far the applied stiffness may go below and above the one at the start, as a factor


class Sketch(Task):
    """A motion that was drawn in the plane, and what is asked of it.

    The cost has a term for each thing that there is, times its weight: Σ_l min_j |x_l^via − x_j|², |x^goal − x_T|²,
    Σ_j |v_j − v_{j−1}|, Σ_j |v_j| dt, Σ_r max_j (R_r − |x_j − c_r|)₊² for the regions to stay out of, and Σ_j |s_j| for the
    stiffness of a body. A motion that meets a wall stays there; with a body the point mass does, wherever its reference goes.

    Class attributes:
        problem: what was drawn. The class itself is that of an empty drawing; `of` makes the class of another one.
    """

    problem: ClassVar[Problem] = Problem()

    @classmethod
    def of(cls, problem: Problem, name: str = "sketch") -> type[Sketch]:
        """The class of a problem, with its first learner as that of the training command.

        Args:
            problem: that was drawn.
            name: of the task.
        """
        stable = problem.condition != "none"
        usual = {"exploration": "stable" if stable else "homogeneous"}
        own: dict[str, Any] = {
            "__doc__": f"{problem.name or name}, a problem that was drawn.",
            "name": name,
            "problem": problem,
            "differentiable": not problem.walls,
            "n_components": problem.components,
            "defaults": {**usual, **problem.learners[0]},
        }
        return cast("type[Sketch]", type(cls.__name__, (cls,), own))

    def __post_init__(self) -> None:
        drawn = self.problem
        self.start, self.via_points, self.segments = (
            torch.tensor(points, dtype=torch.float64) if points else None
            for points in (drawn.start, drawn.via_points, drawn.walls)
        )
        self.regions = None
        if drawn.regions:
            centres, radii = zip(*((region["center"], region["radius"]) for region in drawn.regions), strict=True)
            self.regions = Regions(*(torch.tensor(part, dtype=torch.float64) for part in (centres, radii)))
        walls = None if self.segments is None else Walls(self.segments)
        if drawn.body is None:
            self.stop = walls
        else:
            self.plant = self.controlled(drawn.body) if walls is None else Walled(self.controlled(drawn.body), walls)
        self.feedback = drawn.body is not None and drawn.body["execution"] != "open"

    def controlled(self, body: Mapping[str, Any]) -> ImpedanceControlled | PassiveControlled:
        """The point mass with its controller."""
        mass = PointMass(mass=body["mass"], damping=body["damping"], force=self.force(body))
        low, high = body["stiffness"] / RANGE, body["stiffness"] * RANGE
        if body["execution"] == "passive":
            return PassiveControlled(mass, None, low=low, high=high)
        return ImpedanceControlled(mass, low=low, high=high)

    def force(self, body: Mapping[str, Any]) -> Force | None:
        """The field of force: the same everywhere, or away from the mean of the demonstrations."""
        if body["field"] == "constant":
            return ConstantForce(torch.tensor(body["force"], dtype=torch.float64))
        if body["field"] == "divergent":
            n = min(len(each.x) for each in self.demonstrations)
            return DivergentForce(torch.stack([d.x for d in self.demonstrations.resample(n)]).mean(0), body["gain"])
        return None

    # ------------------------------------------------------------------ the motion

    def default_demonstrations(self) -> Demonstrations:
        """The strokes, moved to end at the goal where one is given."""
        demos, goal = self.problem.demonstrations(), self.problem.goal
        return demos if goal is None else demos.shift_to_goal(goal)

    @cached_property
    def goal(self) -> Tensor:
        """`(D,)` the goal that is given, or the mean end of the demonstrations."""
        ends = torch.stack([d.x[-1] for d in self.demonstrations])
        return ends.mean(0) if self.problem.goal is None else ends.new_tensor(self.problem.goal)

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """The mixture of the drawing, from fewer starts and with a looser tolerance than usual: who draws waits for it."""
        floor = self.floor(demonstrations)
        return GaussianMixture.fit(
            demonstrations, self.n_components, covariance_floor=floor, n_init=STARTS, tol=TOLERANCE
        )

    @cached_property
    def stable_fit(self) -> StableFit:
        """The fit under the condition of stability."""
        condition = cast(Condition, self.problem.condition)
        return moved(fit_stable(self.demonstrations, self.n_components, condition, goal=self.goal), *self.place)

    @property
    def P(self) -> Tensor | None:
        """The matrix in the condition that the policy satisfies; None for the identity."""
        return self.stable_fit.P if self.problem.condition == "p-qlf" and self.given_mixture is None else None

    def policy(self) -> GMRPolicy:
        """The imitated motion, stable where that is asked for; with a body, with a stiffness for each axis."""
        body = self.problem.body
        if self.problem.condition != "none" and self.given_mixture is None:
            motion = copy.deepcopy(self.stable_fit.policy)
            return motion if body is None else with_constant_stiffness(motion, 2, body["stiffness"])
        if body is None:
            return without_stiffness(self.mixture, 2, 2, "there is no body whose stiffness it could be")
        return with_stiffness(self.mixture, 2, 2, 2, body["stiffness"])

    def motion(self) -> Motion:
        """As long as the longest demonstration, from the start that is given or the mean one."""
        motion = super().motion()
        return motion if self.start is None else motion._replace(x0=self.start.to(motion.x0))

    # ------------------------------------------------------------------ what it costs

    def weighed(self, terms: Mapping[str, Callable[[], Tensor]]) -> dict[str, Tensor]:
        """Terms times their weights; those without a weight are left out, but for the goal."""
        weights = self.problem.weights
        return {name: weights[name] * term() for name, term in terms.items() if weights[name] > 0 or name == "goal"}

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """What there is among via-points, goal, regions and the terms of each step."""
        terms: dict[str, Callable[[], Tensor]] = {"goal": lambda: costs.goal(path.x, self.goal)}
        if (points := self.via_points) is not None:
            terms["via_points"] = lambda: costs.via_points(path.x, points)
        if (regions := self.regions) is not None:
            terms["regions"] = lambda: costs.intrusion(path.x, *regions)
        return self.weighed(terms) | {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The terms of acceleration, path length and stiffness by steps."""
        terms: dict[str, Callable[[], Tensor]] = {
            "acceleration": lambda: costs.acceleration_steps(path.v),
            "path_length": lambda: torch.linalg.vector_norm(path.v, dim=-1) * path.dt,
        }
        if self.plant is not None:
            terms["stiffness"] = lambda: torch.linalg.vector_norm(path.plant.stiffness[..., 1:, :], dim=-1)
        return self.weighed(terms)

    def scene(self) -> Scene:
        """Start, goal, via-points, walls and regions."""
        via = {} if self.via_points is None else {"via-points": self.via_points}
        starts = self.motion().x0[None]
        return Scene(starts, self.goal, via, self.problem.unit, self.segments, self.regions)


def of_file(path: str | Path) -> type[Sketch]:
    """The class of the problem in a file, the same one while its content is; its name is that of the file.

    Raises:
        FileError: no such file, or no JSON.
        InvalidArgumentError: no problem, see `Problem.from_json`.
    """
    spec = absolute(str(path))
    return _made(short(spec), json.dumps(Problem.read(spec).to_json()))


@cache
def _made(name: str, content: str) -> type[Sketch]:
    return Sketch.of(Problem.from_json(json.loads(content)), name)
