"""The options of the training commands; `--help` shows every field with its line."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, make_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args, get_type_hints

import torch
import tyro

import tasks
from tasks.loading import absolute, is_spec
from tasks.plain import fits, plain, required, restored, words
from torchds.errors import InvalidArgumentError, UnknownNameError

Exploration = Literal["homogeneous", "trajectory", "gaussian", "stable", "stable-trajectory"]

Optimizer = Literal[
    "pibb", "pi2", "pi2cma", "surrogate", "nes", "cma", "cobyqa", "finite_differences", "adam", "sgd", "lbfgs"
]

LEARNERS: dict[str, dict[str, Any]] = {
    "pibb": {"optimizer": "pibb", "exploration": "homogeneous"},
    "recommended": {"optimizer": "surrogate", "exploration": "trajectory"},
}
"""Options of the two learners that are held against each other: that of the paper, and the one to recommend."""

Options = TypeVar("Options", bound="RunOptions")

UNKEPT = ("resume", "folder", "patience")
"""Options of one command, which are no part of the run."""


@dataclass
class RunOptions:
    """What every run knows, whatever its task; `options_class` adds the options of one task."""

    task: ClassVar[str]

    runs: int = 1
    """Independent learning runs; all of them advance in one batch."""
    seed: int = 0
    """Seed of the exploration noise."""
    updates: int | None = None
    """Policy updates; the task's own number if not given."""
    rollouts: int | None = None
    """Roll-outs per update; the task's own number if not given."""
    optimizer: Optimizer | str = "pibb"
    """What learns. pibb: probability-weighted averaging, Algorithm 1 of the paper. pi2: averaged over time steps.
    pi2cma: pibb that adapts the covariance of its noise, without decay. surrogate: pibb that tries what similar roll-outs
    make look cheap; with --exploration trajectory, the recommended learner of all tasks. The others search over the unit
    normals of the exploration as it is at the start. nes: score-function gradient. cma: CMA-ES. cobyqa: quadratic models
    in a trust region. finite_differences. adam, sgd, lbfgs: the gradient of the trial itself.
    FILE.py:NAME or MODULE:NAME: your own."""
    exploration: Exploration | str = "homogeneous"
    """Parameter noise. homogeneous: equal in task space (Eq. 14-18). trajectory: equal along the motion. gaussian: one
    standard deviation for all. stable: keeps a stable policy stable (Eq. 19-23). stable-trajectory: that, along the
    motion. FILE.py:NAME or MODULE:NAME: your own."""
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
    learn: Literal["both", "motion", "stiffness"] = "both"
    """What the homogeneous exploration perturbs where a policy has a stiffness: motion and stiffness, or one of them."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where trials are made and policies learn; the noise is the same on both. The digging runs on the CPU alone."""
    convention: Literal["paper", "released"] = "paper"
    """The problem as the paper prints it, or as the authors' program runs it, where a task has both."""
    demonstrations: Path | None = None
    """Demonstrations to learn from in place of the task's own: .csv, .npz, .mat, or a folder of .csv."""
    mixture: Path | None = None
    """A fitted mixture (.npz with priors, means, covariances) in place of fitting one."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where runs write: LOGDIR/<task>/<optimizer>/<time>-<seed>/."""
    resume: Path | None = None
    """Continue the run in this folder, with its own options. Of those given beside it more --updates extend the run; others
    are refused where they differ."""
    folder: Path | None = None
    """The folder of the run in place of one below --logdir; where a run is there already, it is continued as by --resume. So
    the same command can be given again whatever happened."""
    patience: float = 1800.0
    """Under torchrun: how long the processes wait for each other in an update [s], before the run stops."""

    def __post_init__(self) -> None:
        for option, known in (("optimizer", Optimizer), ("exploration", Exploration)):
            name = getattr(self, option)
            if not is_spec(name) and name not in get_args(known):
                raise UnknownNameError(option, name, get_args(known))
            setattr(self, option, absolute(name))

    def task_options(self) -> dict[str, Any]:
        """The options that go to `tasks.make`."""
        own = [field.name for field in fields(tasks.options_of(self.task)) if field.init]
        return {name: getattr(self, name) for name in (*own, "convention")}

    def make_task(self) -> tasks.Task:
        """The task with these options, on their device.

        Raises:
            InvalidArgumentError: a device that is not there, or on which the task cannot be tried.
        """
        if self.device == "cuda" and not torch.cuda.is_available():
            built = f"built for CUDA {torch.version.cuda}" if torch.version.cuda else "built for the CPU"
            raise InvalidArgumentError(
                f"--device cuda needs a GPU that torch can use, got none (torch {torch.__version__}, {built}); use --device cpu"
            )
        return tasks.make(self.task, **self.task_options()).to(self.device)

    @property
    def name(self) -> str:
        """The task's name, where `task` may be the place of its class."""
        return tasks.options_of(self.task).name

    def to_json(self) -> dict[str, Any]:
        """Plain values, as options.json and results.json keep them and JSON gives them back."""
        return {name: plain(value) for name, value in asdict(self).items() if name not in UNKEPT}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """What `to_json` gave; what is not there, as in a file of an older version, is as usual.

        Raises:
            InvalidArgumentError: an option that does not exist, a value that it cannot have, or none where one has to be.
        """
        return _made(cls, cls.read(values))

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Some options, by name, from plain values.

        Raises:
            InvalidArgumentError, UnknownNameError: see `from_json`.
        """
        kinds = get_type_hints(cls)
        known = {field.name: kinds[field.name] for field in fields(cls) if field.name not in UNKEPT}
        for name, value in values.items():
            if name not in known:
                raise UnknownNameError(f"option of {getattr(cls, 'task', 'a run')}", name, known)
            if not fits(value, known[name]):
                raise InvalidArgumentError(f"the option {name} cannot be {value!r}; it has to be {words(known[name])}")
        return {name: restored(value, known[name]) for name, value in values.items()}


def check_seed(seed: int, bits: int = 63) -> None:
    """Refuse a seed that no generator takes.

    Raises:
        InvalidArgumentError: it is negative, or has more bits.
    """
    if not 0 <= seed < 2**bits:
        raise InvalidArgumentError(f"--seed has to be a whole number from 0 to 2^{bits} - 1, got {seed}")


def options_class(task: str) -> type[RunOptions]:
    """The options of a run of a task: those of `RunOptions`, and the task's own fields.

    Args:
        task: its name, or where it stands: "my_file.py:MyTask", "my_problem.json".

    Raises:
        UnknownNameError: no task of this name, or one whose defaults name an option that does not exist.
        InvalidArgumentError: no task stands there, or one with a field that a command line cannot give, a default that its
            option cannot have, or a field with the name of an option of every run and another default.
    """
    return _derived(absolute(task), tasks.options_of(task))


def options_for(task: str, **values: Any) -> RunOptions:
    """Options of a run of `task`, of which `values` are given and the others are as usual.

    Raises:
        InvalidArgumentError: one is missing that has no default.
    """
    return _made(options_class(task), values)


def usual_values(options: RunOptions) -> dict[str, Any]:
    """Plain values, as `to_json` has them, of the options that have a default; those of a task may have none."""
    needed: dict[str, Any] = dict.fromkeys(required(options))
    return {name: value for name, value in type(options)(**needed).to_json().items() if name not in needed}


def _made(cls: type[Options], values: Mapping[str, Any]) -> Options:
    if missing := [name for name in required(cls) if name not in values]:
        raise InvalidArgumentError(
            f"{cls.task} needs the option {', '.join(missing)}, which has no default: say it, or give it one"
        )
    return cls(**values)


@cache
def _derived(spec: str, task: type[tasks.Task]) -> type[RunOptions]:
    """A field that both have, as a seed, keeps the meaning, the type and the default that `RunOptions` gives it."""
    defaults = RunOptions.read(task.defaults)
    shared = {each.name: defaults.get(each.name, _usual(each)) for each in fields(RunOptions)}
    of_all = {each.name for each in fields(tasks.Task)}
    hints, lines = get_type_hints(task), field_lines(task)
    own: list[Any] = []
    for each in fields(task):
        if each.init and each.name not in shared:
            # Fields are copied, since making a dataclass writes on them.
            usual: Any = field(**{name: getattr(each, name) for name in ("default", "default_factory")})
            own.append((each.name, _explained(hints[each.name], lines.get(each.name, "")), usual))
        elif each.init and each.name not in of_all and _usual(each) not in (MISSING, shared[each.name]):
            raise InvalidArgumentError(
                f"the field {each.name} of {task.__name__} has the name of an option of every run, which is "
                f"{shared[each.name]!r} if nothing is said, and not {_usual(each)!r}; give the field another name"
            )
    kinds, lines = get_type_hints(RunOptions), field_lines(RunOptions)
    said = [(name, _explained(kinds[name], lines[name]), field(default=usual)) for name, usual in defaults.items()]
    first = (inspect.getdoc(task) or task.__name__).split("\n\n")[0]
    return make_dataclass(
        f"{task.__name__}Options",
        [*said, *own],
        bases=(RunOptions,),
        namespace={"task": spec, "__doc__": first},
        kw_only=True,
    )


def _usual(field: Field[Any]) -> Any:
    """What a field is if nothing is said; MISSING where something has to be."""
    return field.default if field.default_factory is MISSING else field.default_factory()


def _explained(kind: Any, line: str) -> Any:
    """The type of an option, with its line for `--help`."""
    return Annotated[kind, tyro.conf.arg(help=line)]


def field_lines(cls: type) -> dict[str, str]:
    """The string below each annotated field of a class and of its bases, by name."""
    found: dict[str, str] = {}
    for each in reversed(cls.__mro__[:-1]):
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(each)))
        except (OSError, TypeError, SyntaxError):  # a class without a file
            continue
        body = getattr(tree.body[0], "body", [])
        for target, text in pairwise(body):
            said = text.value if isinstance(text, ast.Expr) else None
            if isinstance(target, ast.AnnAssign) and isinstance(said, ast.Constant) and isinstance(said.value, str):
                found[ast.unparse(target.target)] = " ".join(said.value.split())
    return found
