"""What the paper leaves to others, measured at equal numbers of trajectories: `python -m train beyond`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from tqdm import tqdm

import tasks
from tasks.settings import PAPER_FLOOR
from torchds import GaussianMixture
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.files import write_json
from torchds.optim import repeated
from torchds.recruiting import most_wanted, recruit
from train.beyond.starts import one_start
from train.folder import new_folder, versions, write_text
from train.learning.learner import Learner
from train.options import LEARNERS, RunOptions, check_seed, options_for
from train.searchers.base import Closure
from train.statistics import differ, of_costs
from train.tables import markdown

Experiment = Literal["recruit", "noise", "starts"]
LearnerName = Literal["pibb", "recommended"]

SPLITS = ((10, 50, 1), (20, 25, 1), (10, 25, 2), (10, 10, 5))
"""Policies of an update, updates, and trials of each policy: 500 trials."""


class Way(NamedTuple):
    """One row to be.

    Attributes:
        group: what it is compared in; the first way of a group is the paper's.
        label: its name there.
        options: of the learner.
        n_components: K; None for the task's own.
        wrap: what is done to the trials of the learner.
        grow: shares of the updates after which Gaussians are recruited.
        trajectories: of each roll-out.
    """

    group: str
    label: str
    options: RunOptions
    n_components: int | None = None
    wrap: Callable[[Closure, Learner], Closure] | None = None
    grow: Sequence[float] = ()
    trajectories: int = 1


@dataclass
class Beyond:
    """Recruiting Gaussians, noise in the system, and one start a trial, each against the paper's way."""

    experiments: tuple[Experiment, ...] = get_args(Experiment)
    """recruit: new Gaussians where the motion needs them. noise: policies or repeats. starts: one start a trial."""
    learners: tuple[LearnerName, ...] = get_args(LearnerName)
    """pibb: as in the paper. recommended: --optimizer surrogate --exploration trajectory."""
    levels: tuple[float, ...] = (0.0, 0.1, 0.5)
    """Standard deviations of noise in the cost of a trial, as shares of the initial policy's cost."""
    runs: int = 20
    """Learning runs of each row, in one batch."""
    seed: int = 0
    """Of the exploration noise."""
    width: float = 2.0
    """Of the recruited Gaussians [position unit of the task]."""
    budget: float = 1.0
    """Factor on the updates of every row; less than one for a quick look."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where to write: LOGDIR/beyond/."""

    def main(self) -> Path:
        """Run, write tables and costs, and return their folder.

        Raises:
            InvalidArgumentError: numbers out of range.
            UnknownNameError: an experiment or a learner that does not exist.
        """
        for kind, received, known in (
            ("experiment", self.experiments, get_args(Experiment)),
            ("learner", self.learners, get_args(LearnerName)),
        ):
            for name in received:
                if name not in known:
                    raise UnknownNameError(kind, name, known)
        if self.runs < 2 or not self.budget > 0 or not self.width > 0 or min(self.levels, default=0.0) < 0:
            raise InvalidArgumentError(
                f"--runs of at least 2, a positive --budget and --width and --levels ≥ 0 are needed, got {self.runs}, "
                f"{self.budget}, {self.width} and {self.levels}"
            )
        check_seed(self.seed)
        folder = new_folder(self.logdir / "beyond")
        lines = [
            "# Beyond the paper",
            "",
            f"Cost of the noise-free policy after the last update: median and quartiles of {self.runs} seeds; p of the "
            "two-sided Mann-Whitney test against the first row of the group.",
        ]
        found: dict[str, list[dict[str, Any]]] = {}
        for experiment in self.experiments:
            ways = list(getattr(self, experiment)())
            results = [self.final(way) for way in tqdm(ways, unit="row", desc=experiment, dynamic_ncols=True)]
            first = {way.group: costs for way, (_, costs) in reversed(list(zip(ways, results, strict=True)))}
            rows = []
            for way, (trajectories, costs) in zip(ways, results, strict=True):
                q1, median, q3 = (f"{value:.3g}" for value in of_costs(costs))
                base = first[way.group]
                p = "" if base is costs else f"{differ(costs, base):.1g}"
                rows.append((way.group, way.label, str(trajectories), median, q1, q3, p))
                row = {"group": way.group, "way": way.label, "trajectories": trajectories, "cost": costs}
                found.setdefault(experiment, []).append(row)
            table = markdown(("", "way", "trajectories", "median", "q1", "q3", "p"), rows)
            lines += ["", f"## {experiment}", "", table]
        text = "\n".join(lines) + "\n"
        write_text(folder / "report.md", text)
        write_json(folder / "costs.json", {"versions": versions(), "rows": found})
        print(text)
        print(f"report.md and costs.json in {folder}")
        return folder

    def final(self, way: Way) -> tuple[int, list[float]]:
        """Trajectories spent, and the final costs of the runs."""
        options: dict[str, Any] = {} if way.n_components is None else {"mixture": fitted(way.options, way.n_components)}
        task = tasks.make(way.options.task, **{**way.options.task_options(), **options})
        learner = Learner(way.options, task, wrap=way.wrap)
        due = [round(share * learner.n_updates) for share in way.grow]
        learner.start()
        while learner.done < learner.n_updates:
            if learner.done in due:
                grow(learner, self.width)
            learner.update()
        return learner.history.rollouts[-1] * way.trajectories, learner.history.cost[-1]

    def options(self, task: str, updates: int, **more: Any) -> RunOptions:
        """The options of one row."""
        return options_for(task, runs=self.runs, seed=self.seed, updates=max(1, round(self.budget * updates)), **more)

    # ------------------------------------------------------------------ the experiments

    def recruit(self) -> Iterator[Way]:
        """Few Gaussians, the same with recruiting, and as many from the beginning."""
        problems: list[tuple[str, dict[str, Any], LearnerName]] = [
            ("via_point", {"shape": "N"}, "pibb"),
            ("via_point", {"shape": "P"}, "pibb"),
            ("via_point", {"shape": "N"}, "recommended"),
            ("via_point", {"shape": "P"}, "recommended"),
            ("two_starts", {}, "pibb"),
        ]
        for task, own, learner in problems:
            if learner not in self.learners:
                continue
            group = f"{own.get('shape', task)}, {learner}"
            two = task == "two_starts"
            options = self.options(task, 100 if two else 50, **own, **LEARNERS[learner])
            way = Way(group, "3, frozen, as in the paper", options, 3, trajectories=1 + two)
            yield way
            yield way._replace(label="3, and 3 more after 1/8 of the updates", grow=(1 / 8,))
            yield way._replace(label="3, and 3 more after 1/2 of the updates", grow=(1 / 2,))
            yield way._replace(label="6, frozen", n_components=6)

    def noise(self) -> Iterator[Way]:
        """Policies or repeats, under noise of several sizes."""
        for std in self.levels:
            for learner in self.learners:
                for n, updates, repeats in SPLITS:
                    label = f"{n} policies × {repeats} trials an update"
                    options = self.options("via_point", updates, rollouts=n, cost_noise=std, **LEARNERS[learner])
                    yield Way(
                        f"noise {std}, {learner}", label, options, wrap=partial(repeat, repeats), trajectories=repeats
                    )

    def starts(self) -> Iterator[Way]:
        """Both starts in each trial, or one, at equal numbers of trajectories."""
        for learner in self.learners:
            group = f"two_starts, {learner}"
            yield Way(
                group,
                "both starts, as in the paper",
                self.options("two_starts", 100, **LEARNERS[learner]),
                trajectories=2,
            )
            for n, updates in ((40, 100), (20, 200)):
                options = self.options("two_starts", updates, rollouts=n, **LEARNERS[learner])
                yield Way(group, f"one start, {n} policies an update", options, wrap=one_each)


def fitted(options: RunOptions, n_components: int) -> GaussianMixture:
    """A mixture of another number of Gaussians over the task's own demonstrations."""
    return GaussianMixture.fit(options.make_task().demonstrations, n_components, covariance_floor=PAPER_FLOOR)


def repeat(repeats: int, closure: Closure, learner: Learner) -> Closure:
    """Each policy is tried several times."""
    return repeated(closure, learner.policy.parameters(), repeats)


def one_each(closure: Closure, learner: Learner) -> Closure:
    """Each policy is tried from one start only."""
    optim = learner.searcher.optim
    assert optim is not None
    return one_start(learner.task, learner.policy, optim.n_rollouts, optim.param_groups[0]["temperature"])


def grow(learner: Learner, width: float) -> None:
    """Recruit Gaussians where the motion of each run needs them, and learn on."""
    assert learner.path is not None
    learner.restart(recruit(learner.policy, most_wanted(learner.path, learner.task.cost), width))
