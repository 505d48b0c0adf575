"""The interface of a task."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, costs, load, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Homogeneous
from torchds.optim.functional import Temperature
from torchds.plants import Plant
from torchds.rollouts import StopCondition

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
    """What a task proposes to whoever searches: the paper's numbers, as defaults.

    Attributes:
        n_updates: policy updates.
        n_rollouts: N, roll-outs per update.
        control_weight: r of the control cost r I.
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
    control_weight: float = 5e-4
    mean_speed: float = 0.1
    homogeneous: type[Homogeneous] = Homogeneous
    std: float = 0.01
    spread: tuple[float, ...] | None = None
    mean_stiffness: float = 0.0
    stiffness_spread: float | None = None
    temperature: Temperature = "range"
    decay: Literal["inverse", "linear", "exponential", "none"] = "inverse"
    elite: Literal["none", "nominal", "best"] = "none"


@dataclass(frozen=True)
class Scene:
    """What there is to see in a task, for figures.

    Attributes:
        starts: `(S, D)`.
        goal: `(D,)`.
        via_points: sets of `(L, D)` points by name.
        walls: `(W, 2, D)` the ends of each; None without.
        unit: of positions.
    """

    starts: Tensor
    goal: Tensor
    via_points: dict[str, Tensor] = field(default_factory=dict)
    unit: str = ""
    walls: Tensor | None = None


class Task(ABC):
    """A motion to learn: demonstrations, a way to try a policy, and what the trial costs.

    Args:
        demonstrations: in place of the task's own, as an object or a path that `torchds.load` reads.
        mixture: in place of one fitted to the demonstrations, as an object or a path of an .npz file.
        convention: "paper" as printed, or "released" for the problem as the authors' program runs it, where a task
            has it.

    Class attributes:
        name: in the registry and in `logs/`.
        conventions: the ones that the task has.
        differentiable: whether the cost of a trial has gradients with respect to the policy.

    Attributes:
        plant: what tracks the motion; None where the motion itself counts.
        stop: what ends it early; None for nothing.
    """

    name: str
    differentiable = True
    conventions: tuple[Convention, ...] = ("paper",)
    search: SearchSettings
    plant: Plant | None = None
    stop: StopCondition | None = None

    def __init__(
        self,
        *,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        if convention not in self.conventions:
            raise InvalidArgumentError(
                f"task {self.name!r} has the convention {' or '.join(map(repr, self.conventions))}, got {convention!r}"
            )
        self.convention = convention
        self._demonstrations = load(demonstrations) if isinstance(demonstrations, (str, Path)) else demonstrations
        self._mixture = GaussianMixture.load(mixture) if isinstance(mixture, (str, Path)) else mixture

    # ------------------------------------------------------------------ what a task says

    @abstractmethod
    def default_demonstrations(self) -> Demonstrations:
        """The task's own demonstrations."""

    @abstractmethod
    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """The mixture that the policy is made of."""

    @abstractmethod
    def policy(self) -> GMRPolicy:
        """A new policy as learned from the demonstrations."""

    @abstractmethod
    def motion(self) -> Motion:
        """Where the reference motion begins, and for how long it goes on."""

    @abstractmethod
    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """The named cost terms of a trial, each `(*batch)`; their sum is the cost."""

    @abstractmethod
    def scene(self) -> Scene:
        """What a figure of the task shows."""

    @property
    def P(self) -> Tensor | None:
        """Of the condition that a stable policy of this task satisfies (`torchds.stability`); None for the identity."""
        return None

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """Those of the terms that add up over time, step by step `(*batch, T)`; the others come due at the end."""
        return {}

    def diagnostics(self, path: Rollout) -> dict[str, Tensor]:
        """What else is worth a look in a trial, `(*batch, ...)` by TensorBoard tag."""
        return {}

    def film(self, path: Rollout, frames: int) -> np.ndarray | None:
        """Pictures `(frames, height, width, 3)` in bytes of the first trial in `path`, its end last; None where none are made.

        Raises:
            TorchdsError: this machine cannot make them.
        """
        return None

    def state_dict(self) -> dict[str, Any]:
        """What changes from trial to trial; plain values and tensors only."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""

    # ------------------------------------------------------------------ what follows from it

    def rollout(self, policy: GMRPolicy) -> Rollout:
        """Try `policy`, of any batch_shape, from all starts and under all conditions of the task."""
        return rollout(policy, *self.motion(), stop=self.stop, plant=self.plant)

    def needs_data(self) -> InvalidArgumentError:
        """The error of a convention whose demonstrations the user has to bring."""
        return InvalidArgumentError(
            f"{self.name} with convention={self.convention!r} has no demonstrations of its own, theirs carry no licence; "
            "give demonstrations=PATH or mixture=PATH"
        )

    @cached_property
    def demonstrations(self) -> Demonstrations:
        """The demonstrations in use."""
        return self._demonstrations if self._demonstrations is not None else self.default_demonstrations()

    @property
    def source(self) -> Demonstrations | None:
        """The demonstrations behind the policy; None where a mixture was given without any."""
        return None if self._mixture is not None and self._demonstrations is None else self.demonstrations

    @cached_property
    def mixture(self) -> GaussianMixture:
        """The mixture in use."""
        return self._mixture if self._mixture is not None else self.fit(self.demonstrations)

    def cost(self, path: Rollout) -> Tensor:
        """The cost of a trial `(*batch)`, without the control cost, which an optimizer adds."""
        return total(self.cost_terms(path).values())

    def step_costs(self, path: Rollout) -> Tensor:
        """The cost by steps `(*batch, T)`, terminal costs in the last, as `PI2` wants it."""
        running = self.running_costs(path)
        terms = self.cost_terms(path)
        terminal = total(value for name, value in terms.items() if name not in running)
        steps = total(running.values()) if running else terminal.new_zeros(*terminal.shape, path.v.shape[-2])
        return torch.cat([steps[..., :-1], (steps[..., -1] + terminal).unsqueeze(-1)], -1)

    def evaluate(self, policy: GMRPolicy) -> tuple[Rollout, dict[str, Tensor]]:
        """A trial without noise and all its cost terms `(*batch)`, the control cost among them."""
        path = self.rollout(policy)
        deviation = policy.rows() - policy.initial_rows
        upsilon = costs.control_cost(deviation, torch.zeros_like(deviation), path.features, self.search.control_weight)
        terms = self.cost_terms(path)
        return path, {**terms, "control": 0.5 * upsilon.flatten(len(policy.batch_shape)).sum(-1)}


def total(terms: Iterable[Tensor]) -> Tensor:
    """The sum of cost terms."""
    return torch.stack(list(terms)).sum(0)
