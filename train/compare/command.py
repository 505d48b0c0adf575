"""Optimizers beside each other, on the same tasks and budgets: `python -m train compare`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from tqdm import tqdm

from tasks import PROBLEMS
from tasks.loading import is_spec, short, told_apart
from tasks.transfer import TRANSFER
from torchds.errors import FileError, InvalidArgumentError, TorchdsError, UnknownNameError
from train.compare import report, suite
from train.compare.report import Outcome
from train.folder import Interrupted, RunFolder, new_folder, versions, write_text
from train.learning.kept import found, key, learned, made
from train.learning.learner import Learner
from train.options import Optimizer, RunOptions, check_seed, options_class, options_for, required, usual_values
from train.searchers.named import METHODS, runs_vary
from train.statistics import of_costs

TUNING_SEED = 1000  # added to the seed of the reported runs

CoordinateKind = Literal["plain", "trajectory"]
FREE, STABLE = ("homogeneous", "trajectory"), ("stable", "stable-trajectory")  # the explorations of both kinds
KNOWN = PROBLEMS | TRANSFER
IN_PLACES = ("optimizer", "shape", "runs", "updates", "seed", "logdir", "device", "threads")
"""Options that a row has a place for, or that do not change what is learned."""


class Candidate(NamedTuple):
    """One row to be: an optimizer on a problem, with noise or coordinates of one kind."""

    problem: str
    optimizer: str
    coordinates: str

    def label(self, names: Mapping[str, str]) -> str:
        """As tables and legends have it, by what they call each place."""
        name = names[self.optimizer]
        return name if self.coordinates == "plain" else f"{name}, {names[self.coordinates]}"


def named(candidates: Iterable[Candidate], records: Iterable[Mapping[str, Any]] = ()) -> dict[str, str]:
    """What tables call problems, optimizers and coordinates, those of rows to be and of results that are added."""
    others = [(record["task"], record["options"]["optimizer"]) for record in records]
    return told_apart(spec for said in (*candidates, *others) for spec in said)


@dataclass
class Compare:
    """Compare optimizers at equal numbers of roll-outs; runs that exist are not made again.

    The first step of every method is tuned over the same factors, on seeds of its own, before the reported runs. A file of
    yours that was edited, or what it imports from beside it, makes new runs; after a change of a module give another --logdir.
    """

    tasks: tuple[str, ...] = ("via_point-N", "via_point-P")
    """Problems: via_point-N, via_point-P, the other tasks by their names, and yours: FILE.py:NAME, MODULE:NAME
    or PROBLEM.json."""
    optimizers: tuple[str, ...] = get_args(Optimizer)
    """As --optimizer of the training commands, yours among them."""
    coordinates: tuple[CoordinateKind | str, ...] = ("plain", "trajectory")
    """plain: noise or coordinates homogeneous in task space, each parameter by itself. trajectory: along the motion.
    Where a task says that its policies stay stable, both do. FILE.py:NAME or MODULE:NAME: those of your exploration."""
    runs: int = 20
    """Reported runs of each row, in one batch; where nothing is random, one stands for all."""
    seed: int = 0
    """Of the reported runs; the tuning runs have others."""
    updates: int | None = None
    """Updates of a sampling optimizer, which say the budget for all; the task's own number if not given."""
    factors: tuple[float, ...] = (1 / 3, 1.0, 3.0)
    """Factors on each method's first step (--scale) that the tuning tries; a single one needs no tuning."""
    tuning_runs: int = 5
    """Runs behind each choice."""
    noise_std: float = 0.0
    """Standard deviation of noise in the cost of each trial, as a share of the initial policy's cost."""
    add: tuple[Path, ...] = ()
    """Folders of finished runs to list too, of whatever command; here PPO and SAC come in."""
    suite: Literal["docs"] | None = None
    """Make all tables of the documentation, with these --runs, --seed, --factors, --tuning-runs and --updates; their rows
    are given."""
    keep: Path | None = None
    """With --suite: the folder whose pages get the tables."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where to write: LOGDIR/compare/."""

    def main(self) -> Path:
        """Run what is missing; write tables, figure and TensorBoard files, and return their folder.

        Raises:
            InvalidArgumentError: numbers out of range, or a folder without results.
            UnknownNameError: a task or an optimizer that does not exist.
            Interrupted: from the keyboard; the same command continues.
        """
        check_seed(self.seed)
        self.check()
        if self.suite is not None:
            return self.all_tables()
        records = [RunFolder(path, "--add").results() for path in self.add]
        candidates = [
            Candidate(problem, optimizer, coordinates)
            for problem in self.tasks
            for optimizer in self.optimizers
            for coordinates in self.coordinates
        ]
        names = named(candidates, records)
        with tqdm(total=len(candidates), unit="row", dynamic_ncols=True) as bar:
            rows = self.rows(candidates, names, bar) + [added(record, names) for record in records]
        folder = new_folder(self.logdir / "compare")
        text = report.write(folder, rows, self.to_json(), versions())
        print(text)
        print(f"tables, curves and TensorBoard files in {folder}")
        return folder

    def all_tables(self) -> Path:
        """The tables of the documentation, in a folder of their own and, with `keep`, in the pages."""
        made, parts = [], list(suite.parts())
        total = sum(len(part.problems) * len(part.methods) for part in parts)
        with tqdm(total=total, unit="row", dynamic_ncols=True) as bar:
            for part in parts:
                factors = self.factors if part.tuned else (1.0,)
                one = replace(self, suite=None, noise_std=part.noise, factors=factors)
                candidates = [Candidate(problem, *method) for problem in part.problems for method in part.methods]
                rows = one.rows(candidates, named(candidates), bar)
                folders = [suite.deep(self.logdir, name, self.updates, self.seed) for name in part.environments]
                records = [RunFolder(folder).results() for folder in folders]
                others = [added(record, named((), records)) for record in records]
                made.append(suite.Made(part, [*rows, *others]))
        usual = {"updates": None, "factors": Compare.factors, "tuning_runs": Compare.tuning_runs}
        given = [name for name, value in usual.items() if getattr(self, name) != value]
        said = [f"--{name.replace('_', '-')} {words(getattr(self, name))}" for name in ("runs", "seed", *given)]
        command = " ".join(["python -m train compare --suite docs", *said])
        tables = suite.tables(made, command)
        folder = new_folder(self.logdir / "compare")
        text = "\n\n".join(f"## {name}\n\n{table}" for name, table in tables.items())
        write_text(folder / "suite.md", f"{text}\n")
        if self.keep is not None:
            suite.keep(self.keep, tables)
        print(text)
        print(f"suite.md in {folder}")
        return folder

    def rows(self, candidates: Sequence[Candidate], names: Mapping[str, str], bar: tqdm) -> list[Outcome]:
        """All rows, by what tables call them, each as soon as it is there on the disk.

        Raises:
            Interrupted: from the keyboard; the same command continues.
        """
        outcomes = []
        try:
            for candidate in candidates:
                problem, label = names[candidate.problem], candidate.label(names)
                bar.set_postfix_str(f"{problem}: {label}")
                outcomes.append(self.row(candidate, problem, label, bar))
                bar.update()
        except KeyboardInterrupt:
            raise Interrupted("stopped; the same command continues") from None
        return outcomes

    def check(self) -> None:
        """Refuse what cannot be compared, before anything runs."""
        for kind, received, known in (
            ("problem", [name for name in self.tasks if not is_spec(name)], KNOWN),
            ("optimizer", [name for name in self.optimizers if not is_spec(name)], get_args(Optimizer)),
            ("coordinates", [name for name in self.coordinates if not is_spec(name)], get_args(CoordinateKind)),
        ):
            for name in received:
                if name not in known:
                    raise UnknownNameError(kind, name, known)
        if self.runs < 1 or self.tuning_runs < 1 or not self.factors or (self.updates is not None and self.updates < 0):
            raise InvalidArgumentError(
                "--runs and --tuning-runs of at least 1, one of --factors and --updates ≥ 0 are needed, got "
                f"{self.runs}, {self.tuning_runs}, {self.factors} and {self.updates}"
            )
        if not all(factor > 0 for factor in self.factors) or not self.noise_std >= 0:
            raise InvalidArgumentError(
                f"positive --factors and --noise-std ≥ 0 are needed, got {self.factors} and {self.noise_std}"
            )

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        keep = None if self.keep is None else str(self.keep)
        return {**asdict(self), "logdir": str(self.logdir), "keep": keep, "add": [str(path) for path in self.add]}

    # ------------------------------------------------------------------ one row

    def row(self, candidate: Candidate, problem: str, label: str, bar: tqdm) -> Outcome:
        """Tune, run, and summarise one candidate, by what tables call it; what a method refuses is its row."""
        try:
            random = self.random(candidate)
            tuned = (
                {factor: self.final(candidate, factor, bar) for factor in self.factors} if len(self.factors) > 1 else {}
            )
            best = min(tuned, key=lambda factor: tuned[factor]) if tuned else self.factors[0]
            record = self.learned(self.options(candidate, best, self.runs if random else 1, self.seed), bar)
        except FileError:  # of a run that is damaged, or that somebody else makes now: no word about the method
            raise
        except TorchdsError as error:
            return Outcome(problem, label, refused=str(error))
        gradient = candidate.optimizer in METHODS and METHODS[candidate.optimizer].gradient
        return Outcome(problem, label, record, best, tuned, random=random, gradient=gradient)

    def final(self, candidate: Candidate, factor: float, bar: tqdm) -> float:
        """What the choice goes by: the median final cost of the tuning runs; one that is not finite counts as infinite."""
        random = self.random(candidate)
        runs, seed = (self.tuning_runs, self.seed + TUNING_SEED) if random else (1, self.seed)
        return float(of_costs(self.learned(self.options(candidate, factor, runs, seed), bar)["cost"][-1])[1])

    def random(self, candidate: Candidate) -> bool:
        """Whether runs of a candidate differ."""
        options = self.options(candidate, 1.0, 1, self.seed)
        return runs_vary(options, made(options))

    def options(self, candidate: Candidate, factor: float, runs: int, seed: int) -> RunOptions:
        """The options of one batch of runs."""
        task, own = KNOWN.get(candidate.problem, (candidate.problem, {}))
        kind: Any = options_class(task)
        stable = kind.exploration in STABLE  # the policy's goal is tied: so are all coordinates
        usual = dict(zip(get_args(CoordinateKind), STABLE if stable else FREE, strict=True))
        if stable and candidate.optimizer in METHODS:
            own = {**own, "shrink": "none"}
        return options_for(
            task,
            runs=runs,
            seed=seed,
            updates=kind.updates if self.updates is None else self.updates,
            optimizer=candidate.optimizer,
            exploration=usual.get(candidate.coordinates, candidate.coordinates),
            scale=factor,
            noise=None,  # what a task says for its own learner is not for all of them
            decay=None,
            temperature=None,
            elite=None,
            cost_noise=self.noise_std,
            logdir=self.logdir,
            **own,
        )

    def learned(self, options: RunOptions, bar: tqdm) -> dict[str, Any]:
        """The results of these options: those on the disk, or new ones, continued where they were interrupted.

        What is on the disk is found by its `train.learning.kept.key`; after a change of other code give another --logdir.
        """
        name = f"{short(options.optimizer)}-{key(options)}"
        folder = RunFolder(self.logdir / "compare" / "runs" / options.name / name)
        if (record := found(folder, options)) is not None:
            return record

        def show(learner: Learner) -> None:
            bar.set_postfix_str(f"{options.task}, {options.optimizer}: update {learner.done} of {learner.n_updates}")

        learner = Learner(options, made(options))
        with folder.alone():
            return learned(folder, learner, show)


def words(value: Any) -> str:
    """A value as it is given to an option."""
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def added(record: Mapping[str, Any], names: Mapping[str, str]) -> Outcome:
    """A row from the results.json of another run, by what tables call its parts, and by its options that are not as usual."""
    shape, optimizer = record["options"].get("shape"), record["options"]["optimizer"]
    own, others = unusual(record)
    problem = names[record["task"]] if shape is None else f"{names[record['task']]}-{shape}"
    gradient = optimizer in METHODS and METHODS[optimizer].gradient
    label = f"{' '.join([names[optimizer], *others])}, added"
    return Outcome(" ".join([problem, *own]), label, dict(record), gradient=gradient)


def unusual(record: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The options of a run that are not as usual, as words: those of its problem, and those of what learned it."""
    try:
        options = options_for(record["task"], **dict.fromkeys(required(options_class(record["task"]))))
    except TorchdsError:  # its file is not there any more
        return [], []
    usual, of_the_task = usual_values(options), options.task_options()
    own: list[str] = []
    others: list[str] = []
    for name in options.to_json().keys() - set(IN_PLACES):
        value = record["options"].get(name, usual.get(name))
        if value != usual.get(name):
            (own if name in of_the_task else others).append(f"{name}={value}".replace(",", ""))
    return sorted(own), sorted(others)
