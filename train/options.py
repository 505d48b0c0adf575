"""The options of the training commands; `--help` shows every field with its line."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

Exploration = Literal["homogeneous", "trajectory", "gaussian", "stable", "stable-trajectory"]

Optimizer = Literal[
    "pibb", "pi2", "pi2cma", "surrogate", "nes", "cma", "cobyqa", "finite_differences", "adam", "sgd", "lbfgs"
]


@dataclass
class RunOptions:
    """Options that every task knows."""

    task: ClassVar[str]

    runs: int = 1
    """Independent learning runs; all of them advance in one batch."""
    seed: int = 0
    """Seed of the exploration noise."""
    updates: int | None = None
    """Policy updates; the task's own number if not given."""
    rollouts: int | None = None
    """Roll-outs per update; the task's own number if not given."""
    optimizer: Optimizer = "pibb"
    """What learns. pibb: probability-weighted averaging, Algorithm 1 of the paper. pi2: averaged over time steps.
    pi2cma: pibb that adapts the covariance of its noise, without decay. surrogate: pibb that tries what similar roll-outs
    make look cheap; with --exploration trajectory, the recommended learner of all tasks. The others search over the unit
    normals of the exploration as it is at the start. nes: score-function gradient. cma: CMA-ES. cobyqa: quadratic models
    in a trust region. finite_differences. adam, sgd, lbfgs: the gradient of the trial itself."""
    exploration: Exploration = "homogeneous"
    """Parameter noise. homogeneous: equal in task space (Eq. 14-18). trajectory: equal along the motion. gaussian: one
    standard deviation for all. stable: keeps a stable policy stable (Eq. 19-23). stable-trajectory: that, along the
    motion."""
    shrink: Literal["all", "direction", "none"] = "all"
    """How stable noise is made. all: its symmetric part is scaled, as in the paper. direction: only what offends is cut.
    none: nothing, but the goal stays a fixed point."""
    noise: float | None = None
    """Size of the exploration: mean speed (homogeneous), share of the motion's extent (trajectory),
    standard deviation (gaussian, stable); the task's own if not given."""
    scale: float = 1.0
    """Factor on the first step of the optimizer, whatever it is: the width of its noise, its rate, or its trust region."""
    cost_noise: float = 0.0
    """Standard deviation of noise in the cost of each trial, as a share of the initial policy's cost."""
    decay: Literal["inverse", "linear", "exponential", "none"] | None = None
    """Exploration decay. inverse: covariance times max(1/n, 0.1) at update n, as the paper. linear: to a tenth, as the
    authors' program. exponential: to 15 % in 50 updates, or in all if these are fewer. The task's own if not given,
    exponential with trajectories, none with pi2cma."""
    temperature: Literal["range", "median", "capped"] | None = None
    """The spread of costs that scales the weights. range: the paper's. median: the authors' program's. capped: range
    after capping bad costs. The task's own if not given, capped with trajectories."""
    elite: Literal["none", "nominal", "best"] | None = None
    """What the first roll-out of an update is: a perturbed policy, the unperturbed one, or the best so far; the task's
    own if not given, nominal with surrogate."""
    convention: Literal["paper", "released"] = "paper"
    """The problem as the paper prints it, or as the authors' program runs it, where a task has both."""
    demonstrations: Path | None = None
    """Demonstrations to learn from in place of the task's own: .csv, .npz, .mat, or a folder of .csv."""
    mixture: Path | None = None
    """A fitted mixture (.npz with priors, means, covariances) in place of fitting one."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where runs write: LOGDIR/<task>/<optimizer>/<time>-<seed>/."""
    resume: Path | None = None
    """Continue the run in this folder; its own options hold, the others given here are ignored."""

    def task_options(self) -> dict[str, Any]:
        """The options that go to `tasks.make`."""
        return {"convention": self.convention, "demonstrations": self.demonstrations, "mixture": self.mixture}

    def to_json(self) -> dict[str, Any]:
        """Plain values, as options.json and results.json keep them."""
        return {name: str(v) if isinstance(v, Path) else v for name, v in asdict(self).items() if name != "resume"}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """What `to_json` gave."""
        paths = {name: Path(values[name]) for name in ("demonstrations", "mixture", "logdir") if values.get(name)}
        return cls(**{**values, **paths})


@dataclass
class ViaPointOptions(RunOptions):
    """Learn a handwritten letter that passes through via-points (section 3.3)."""

    task: ClassVar[str] = "via_point"

    shape: Literal["N", "P"] = "N"
    """The letter."""

    def task_options(self) -> dict[str, Any]:
        """The common options and the shape."""
        return super().task_options() | {"shape": self.shape}


@dataclass
class TwoStartsOptions(RunOptions):
    """Learn one policy for two starts, each with via-points of its own (section 3.3)."""

    task: ClassVar[str] = "two_starts"


@dataclass
class ArchOptions(RunOptions):
    """What the force-field tasks share."""

    initial_stiffness: float | None = None
    """Constant stiffness before learning [N/m]; the task's own if not given."""
    learn: Literal["both", "motion", "stiffness"] = "both"
    """What the homogeneous exploration perturbs: motion and stiffness, or one of them."""

    def task_options(self) -> dict[str, Any]:
        """The common options and the initial stiffness."""
        return super().task_options() | {"initial_stiffness": self.initial_stiffness}


@dataclass
class DivergentFieldOptions(ArchOptions):
    """Learn motion and stiffness in a divergent force field (section 5.4, first experiment)."""

    task: ClassVar[str] = "divergent_field"


@dataclass
class HalfPlaneForceOptions(ArchOptions):
    """Learn motion and stiffness under a force that is there in half of the executions (second experiment)."""

    task: ClassVar[str] = "half_plane_force"

    stiffness: Literal["diagonal", "isotropic"] = "diagonal"
    """A stiffness for each axis, or one for both."""

    def task_options(self) -> dict[str, Any]:
        """The common options, the initial stiffness and its kind."""
        return super().task_options() | {"stiffness": self.stiffness}


@dataclass
class ConstrainedReachingOptions(RunOptions):
    """Learn the shortest way around a wall, stable all the time (section 4.3)."""

    task: ClassVar[str] = "constrained_reaching"

    exploration: Exploration = "stable"
    """As for the other tasks; here the policy is stable, and noise can keep it so."""
    condition: Literal["seds", "p-qlf"] = "seds"
    """Of the fit. seds: as in the paper. p-qlf: with a learned metric."""

    def task_options(self) -> dict[str, Any]:
        """The common options and the condition."""
        return super().task_options() | {"condition": self.condition}


@dataclass
class LwrDiggingOptions(RunOptions):
    """Learn to shovel gravel with a simulated KUKA LWR (section 6)."""

    task: ClassVar[str] = "lwr_digging"

    initial_stiffness: float = 150.0
    """Uniform stiffness before learning [N/m]."""
    grains: Literal["fine", "coarse"] = "fine"
    """The bed: 330 grains, or 100 large ones for tests."""
    seconds: float = 15.0
    """Duration of the motion."""
    threads: int = 2
    """Threads that share the roll-outs of a batch; the results do not depend on them."""

    def task_options(self) -> dict[str, Any]:
        """The common options and those of the scene; runs of another seed meet other beds."""
        mine = ("initial_stiffness", "grains", "seconds", "threads", "seed")
        return super().task_options() | {name: getattr(self, name) for name in mine}


TASK_OPTIONS: dict[str, type[RunOptions]] = {
    cls.task: cls
    for cls in (
        ViaPointOptions,
        TwoStartsOptions,
        DivergentFieldOptions,
        HalfPlaneForceOptions,
        ConstrainedReachingOptions,
        LwrDiggingOptions,
    )
}
