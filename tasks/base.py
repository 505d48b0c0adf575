"""The interface of a task."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar, dataclass_transform

import numpy as np
import torch
from torch import Tensor

from tasks.imitation import without_stiffness
from tasks.settings import Convention, Motion, Scene, SearchSettings
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, load, rollout
from torchds.devices import Device, moved
from torchds.errors import InvalidArgumentError
from torchds.plants import Plant
from torchds.stops import StopCondition

T = TypeVar("T")

FLOOR = 1e-6  # of the mean variance of the data, see `Task.covariance_floor`


class Given(Generic[T]):
    """A field that is given as an object or as the path of one; the task makes its own where nothing is given.

    Args:
        read: what reads a file.
        make: what makes the task's own, when it is first needed.
    """

    def __init__(self, read: Callable[[Path], T], make: Callable[[Task], T]) -> None:
        self.read, self.make = read, make

    def __set_name__(self, owner: type, name: str) -> None:
        self.given, self.used = f"given_{name}", f"_{name}"

    def __set__(self, task: Task, value: T | str | Path | None) -> None:
        found = moved(self.read(Path(value)) if isinstance(value, (str, Path)) else value, *task.place)
        task.__dict__.update({self.given: found, self.used: found})

    def __get__(self, task: Task | None, owner: type) -> T:
        if task is None:
            return None  # type: ignore[return-value] # the default of the field
        if task.__dict__[self.used] is None:
            task.__dict__[self.used] = moved(self.make(task), *task.place)
        return task.__dict__[self.used]


@dataclass_transform(kw_only_default=True, eq_default=False, field_specifiers=(field,))
@dataclass(kw_only=True, eq=False, repr=False)
class Task(ABC):
    """A motion to learn: demonstrations, a way to try a policy, and what the trial costs.

    A subclass becomes a keyword-only dataclass by itself: each annotated field is an option of `tasks.make` and of the
    training command, and the line below it is the command's help. What needs the fields goes into `__post_init__`.
    Needed are `default_demonstrations` and `cost_terms`; everything else has a default.

    Class attributes:
        name: in the registry and in `logs/`; the class name in snake_case if not given.
        convention: which problem of this name the class is, that of the paper or of its authors' released program.
        differentiable: whether the cost of a trial has gradients with respect to the policy.
        defaults: what the training command takes if nothing else is said, by the names of its options.
        n_components: Gaussians of the mixture.
        covariance_floor: of its fit [unit of the task, squared]; None for a millionth of the mean variance of the data.
        search: what is proposed to whoever searches.
        plant: what tracks the motion; None where the motion itself counts.
        feedback: whether the policy sees the plant; see `torchds.rollout`.
        stop: what ends it early; None for nothing.
        cpu_only: whether trials cannot be made on a GPU.
        chance: what the trials draw their noise from; None for trials without any, of which costs are compared.
        place: device and dtype that `to` has brought everything to; None where it was not asked to.
    """

    demonstrations: Given[Demonstrations] = Given(load, lambda task: task.default_demonstrations())
    """Demonstrations in place of the task's own, as an object or a path that `torchds.load` reads."""
    mixture: Given[GaussianMixture] = Given(GaussianMixture.load, lambda task: task.fit(task.demonstrations))
    """A mixture in place of one fitted to the demonstrations, as an object or a path of an .npz file."""

    name: ClassVar[str] = ""
    convention: ClassVar[Convention] = "paper"
    differentiable: ClassVar[bool] = True
    defaults: ClassVar[Mapping[str, Any]] = {}
    n_components: ClassVar[int] = 4
    covariance_floor: ClassVar[float | None] = None
    cpu_only: ClassVar[bool] = False
    given_demonstrations: Demonstrations | None = field(default=None, init=False)
    given_mixture: GaussianMixture | None = field(default=None, init=False)
    search: SearchSettings = field(default=SearchSettings(), init=False)
    plant: Plant | None = field(default=None, init=False)
    feedback: bool = field(default=False, init=False)
    stop: StopCondition | None = field(default=None, init=False)
    chance: torch.Generator | None = field(default=None, init=False)
    place: tuple[Device, torch.dtype | None] = field(default=(None, None), init=False)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if isinstance(said := cls.__dict__.get("exploration"), str) and "exploration" not in cls.__annotations__:
            raise InvalidArgumentError(
                f"a task says its exploration in `defaults`, got exploration = {said!r}; write defaults = "
                f"{{'exploration': {said!r}}}"
            )
        if "name" not in cls.__dict__:
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        dataclass(kw_only=True, eq=False, repr=False)(cls)

    # ------------------------------------------------------------------ what a task says

    @abstractmethod
    def default_demonstrations(self) -> Demonstrations:
        """What the task learns from if nothing else is given."""

    @abstractmethod
    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """The named cost terms of a trial, each `(*batch)`; their sum is the cost."""

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The cost terms that add up over time, step by step `(*batch, T)`; all other terms come due at the end."""
        return {}

    # ------------------------------------------------------------------ what it may say otherwise

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """The mixture that the policy is made of: `n_components` Gaussians over position and velocity."""
        return GaussianMixture.fit(demonstrations, self.n_components, covariance_floor=self.floor(demonstrations))

    def floor(self, demonstrations: Demonstrations) -> float:
        """What is added to the covariances of the fit: `covariance_floor`, or its share of these data's variance."""
        if self.covariance_floor is not None:
            return self.covariance_floor
        seen = torch.cat([torch.cat([d.x, d.v], -1) for d in demonstrations])
        return FLOOR * float(seen.var(0).mean())

    def policy(self) -> GMRPolicy:
        """A new policy as learned from the demonstrations: position in, as many velocities out."""
        D = self.source.dim if self.source is not None else self.mixture.means.shape[-1] // 2
        return without_stiffness(self.mixture, D, D, "this task learns no stiffness")

    def motion(self) -> Motion:
        """Where the reference motion begins, and for how long it goes on: as the longest demonstration, from the mean start."""
        longest = max(self.demonstrations, key=lambda d: (len(d.x) - 1) * d.dt)
        return Motion(torch.stack([d.x[0] for d in self.demonstrations]).mean(0), len(longest.x) - 1, longest.dt)

    def scene(self) -> Scene:
        """What a figure of the task shows: the starts, and as the goal the mean end of the demonstrations."""
        starts = self.motion().x0
        goal = torch.stack([d.x[-1] for d in self.demonstrations]).mean(0)
        unit = self.demonstrations.units[0] if self.demonstrations.units else ""
        return Scene(starts.reshape(-1, starts.shape[-1]), goal[: starts.shape[-1]], unit=unit)

    @property
    def P(self) -> Tensor | None:
        """The matrix in the stability condition of the policies (`torchds.stability`); None for the identity."""
        return None

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

    def to(self, device: Device = None, dtype: torch.dtype | None = None) -> Self:
        """This task, after all that it holds was moved to `device` and `dtype`, where given; what it makes later follows.

        Raises:
            InvalidArgumentError: a device on which no trials can be made.
        """
        if self.cpu_only and device is not None and torch.device(device).type != "cpu":
            raise InvalidArgumentError(
                f"the trials of {self.name} are made on the CPU alone, got {device}; leave it out"
            )
        self.place = (device or self.place[0], dtype or self.place[1])
        self.__dict__.update(moved({**vars(self), "plant": self.plant, "stop": self.stop}, *self.place))
        return self

    @property
    def noisy(self) -> bool:
        """Whether a trial made again may end otherwise: it draws from `chance`, or the task goes on from trial to trial."""
        return bool(self.state_dict())

    # ------------------------------------------------------------------ what follows from it

    @property
    def source(self) -> Demonstrations | None:
        """The demonstrations behind the policy; None where a mixture was given without any."""
        return self.demonstrations if self.given_mixture is None else self.given_demonstrations

    def rollout(self, policy: GMRPolicy) -> Rollout:
        """Try `policy`, of any batch_shape, from all starts and under all conditions of the task.

        A policy that makes its roll-outs itself, by a method `rollout(x0, n_steps, dt)`, does so where nothing stops or tracks
        it.
        """
        own = getattr(policy, "rollout", None)
        if own is not None and self.plant is None and self.stop is None:
            path: Rollout = own(*self.motion())
            return path
        return rollout(policy, *self.motion(), stop=self.stop, plant=self.tried(policy), feedback=self.feedback)

    def tried(self, policy: GMRPolicy) -> Plant | None:
        """The plant of one trial; a task whose trials are noisy draws the noise from `chance`, where there is one."""
        return self.plant

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

    def about(self, policy: GMRPolicy) -> dict[str, Any]:
        """What a file of a policy of this task says beside the policy, `policy.save(path, **task.about(policy))`."""
        scene, D = self.scene(), policy.input_dim
        names = self.source.names if self.source is not None else ()
        return {
            "goal": scene.goal if scene.goal.shape == (D,) else None,
            "P": self.P,
            "names": names if len(names) == D else (),
            "units": scene.unit,
            "dt": self.motion().dt,
        }

    def evaluate(self, policy: GMRPolicy) -> tuple[Rollout, dict[str, Tensor]]:
        """A trial without noise and all its cost terms `(*batch)`, the control cost among them."""
        path = self.rollout(policy)
        squares = (policy.rows() - policy.initial_rows).square().sum((-2, -1))  # Υ of no noise is r |θ*|² in every step
        n_steps = math.prod(path.inputs.shape[squares.ndim : -1])
        return path, {**self.cost_terms(path), "control": 0.5 * self.search.control_weight * n_steps * squares}


def rolls_out_itself(task: Task, policy: GMRPolicy) -> bool:
    """Whether a trial is something else than `torchds.rollout` of the policy: one of them has a `rollout` of its own."""
    return type(task).rollout is not Task.rollout or hasattr(policy, "rollout")


def total(terms: Iterable[Tensor]) -> Tensor:
    """The sum of cost terms."""
    return torch.stack(list(terms)).sum(0)
