"""The whole digging experiment (section 6): learning runs from two stiffnesses, and the uniform ones to compare with.

Everything stands in one folder; what is there is not measured again, so that the experiment can be stopped at any moment and
spread over many sittings. The first run of everything comes first, then the second: whatever is there is balanced.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

import tasks
from tasks import options_of
from torchds import GMRPolicy
from torchds.errors import FileError
from torchds.files import read_sealed, write_sealed
from train.folder import OPTIONS, RESULTS, RunFolder, check_identity, numbers, say_versions, versions
from train.learning.history import History
from train.learning.learner import Learner
from train.learning.run import run as learn
from train.options import LEARNERS, RunOptions, options_for

STARTS = (150.0, 400.0)  # N/m
PAPER = "as in the paper"  # the learner that the claims are about
SEARCHES: dict[str, dict[str, Any]] = {PAPER: LEARNERS["pibb"], "recommended": LEARNERS["recommended"]}
UNIFORM = (100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0)  # N/m
RUNS = 6  # learning runs of each learner from each start, and groups of trials of each uniform stiffness
TRIALS = 5  # of each policy, in a group on beds of its own
TRIALS_FILE = "trials.json"
TRIALS_SEED = 1000  # of the beds of the first group, which no learning run has met
SEARCH = options_of("lwr_digging").search  # its numbers of updates and roll-outs hold where no others are said
Terms = dict[str, list[float]]
Sample = dict[str, np.ndarray]


class Experiment:
    """Learning runs and measured trials in a folder.

    Args:
        folder: where everything stands.
        seed: of the first learning run; each further run has the next one.
        options: of the scene and of learning; initial stiffness, learner and seed are those of the experiment.
        runs: how many there shall be of each learner from each start.
    """

    def __init__(self, folder: Path, seed: int, options: RunOptions | None = None, runs: int = RUNS) -> None:
        self.folder, self.seed, self.runs = folder, seed, runs
        self.options = options if options is not None else options_for("lwr_digging")

    # ------------------------------------------------------------------ what is there

    def run_folder(self, search: str, start: float, run: int = 0) -> RunFolder:
        """Where one learning run stands, or would stand."""
        return RunFolder(self.folder / f"{SEARCHES[search]['optimizer']}-{start:g}-{run}")

    def run_options(self, search: str, start: float, run: int = 0) -> RunOptions:
        """The options of one learning run."""
        return replace(self.options, **{**SEARCHES[search], "initial_stiffness": start, "seed": self.seed + run})

    def finished(self, search: str, start: float) -> dict[Path, dict[str, Any]]:
        """The results of all finished runs of a learner from a stiffness, by their folders.

        Raises:
            FileError: they are damaged, or of other options.
        """
        prefix = self.run_folder(search, start).path.name.removesuffix("0")
        runs = [path.name.removeprefix(prefix) for path in self.folder.glob(f"{prefix}*")]
        found = {}
        for run in sorted(int(run) for run in runs if run.isdigit()):
            if (folder := self.run_folder(search, start, run)).has(RESULTS):
                found[folder.path] = folder.results()
                check(folder.path / RESULTS, found[folder.path], self.run_options(search, start, run))
        return found

    def recorded(self) -> dict[str, Terms]:
        """The trials that are there: costs and diagnostics `[TRIALS]` by term, "total" among them, of each name.

        Raises:
            FileError: they are damaged, or were measured with other options.
        """
        path = self.folder / TRIALS_FILE
        if not path.is_file():
            return {}
        content = read_sealed(path, unsealed=("trials", "versions"))
        if "options" in content:
            check(path, content, self.options)
            say_versions(path, content["versions"])
        return numbers(content["trials"])

    def names(self) -> list[str]:
        """The groups of trials that there shall be, as they are made: a round of everything, then the next."""
        return [name for run in range(self.runs) for name in self._round(run)]

    def missing(self) -> list[str]:
        """Those that are not there."""
        recorded = self.recorded()
        return [name for name in self.names() if name not in recorded]

    def learned(self, search: str, start: float, run: int = 0) -> Learner:
        """One learning run, finished: made, continued or found."""
        folder, options = self.run_folder(search, start, run), self.run_options(search, start, run)
        if not folder.has(OPTIONS):
            folder.begin(options.task, options.to_json())
        if folder.has(RESULTS):
            check(folder.path / RESULTS, folder.results(), options)
        else:
            begun = folder.options()
            check(folder.path / OPTIONS, {"task": begun.task, "options": begun.to_json()}, options)
            learn(replace(options, resume=folder.path))
        finished = Learner(folder.options())
        folder.restore(finished)
        return finished

    # ------------------------------------------------------------------ what is made

    def go_on(self) -> None:
        """Make all learning runs and trials that are missing.

        Each finished trial is written at once, each learning run leaves a checkpoint after each update: a sitting may end
        anywhere, and the next one goes on.
        """
        with RunFolder(self.folder).alone():
            for name in tqdm(self.missing(), desc="digging", unit="policy", dynamic_ncols=True):
                search, start, run = name.rsplit("-", 2)
                policy = self.learned(search, float(start), int(run)).policy[0] if search in SEARCHES else None
                recorded = {**self.recorded(), name: self.measure(float(start), policy, int(run))}
                said = {"task": self.options.task, "options": self.options.to_json(), "versions": versions()}
                write_sealed(self.folder / TRIALS_FILE, {**said, "trials": recorded})

    def measure(self, start: float, policy: GMRPolicy | None, run: int) -> Terms:
        """TRIALS trials of a policy, or of the imitated one with the uniform stiffness `start`, on the beds of a group."""
        options = {**self.options.task_options(), "initial_stiffness": start, "seed": TRIALS_SEED + run}
        task = tasks.make("lwr_digging", **options)
        path, terms = task.evaluate((task.policy() if policy is None else policy).expand(TRIALS))
        shown = {**terms, "total": torch.stack(list(terms.values())).sum(0), **task.diagnostics(path)}
        return {name: values.tolist() for name, values in shown.items()}

    def _round(self, run: int) -> list[str]:
        """The names of one group of trials of everything."""
        learned = [f"{search}-{start:g}-{run}" for start, search in product(STARTS, SEARCHES)]
        return [f"uniform-{s:g}-{run}" for s in UNIFORM] + learned


# ---------------------------------------------------------------------- samples


def trials(recorded: dict[str, Terms], kind: str) -> Sample:
    """All trials of a kind `(n,)` by term, "uniform-150" say or "recommended-400"; empty where there are none."""
    groups = [terms for name, terms in recorded.items() if name.rpartition("-")[0] == kind]
    return {term: np.concatenate([values(group, term) for group in groups]) for term in (groups[0] if groups else {})}


def means(recorded: dict[str, Terms], kind: str) -> Sample:
    """The mean of each group of trials of a kind `(runs,)` by term: one number for each learning run."""
    groups = [terms for name, terms in recorded.items() if name.rpartition("-")[0] == kind]
    return {term: np.array([values(group, term).mean() for group in groups]) for term in (groups[0] if groups else {})}


def values(group: Terms, term: str) -> np.ndarray:
    """The trials of a group by one term `(n,)`; a cost that is not finite, of a trial that failed, is infinite."""
    found = np.asarray(group[term], dtype=float)
    return found if "/" in term else np.where(np.isfinite(found), found, np.inf)  # a diagnostic is no cost


def best_uniform(recorded: dict[str, Terms]) -> str:
    """The uniform stiffness with the lowest mean cost, as "uniform-300"."""
    kinds = {name.rpartition("-")[0] for name in recorded if name.startswith("uniform")}
    return min(sorted(kinds), key=lambda kind: trials(recorded, kind)["total"].mean())


def history(experiment: Experiment, search: str, start: float) -> History | None:
    """The learning curves of all finished runs of a learner from a stiffness, as of one batch; None where there are none.

    Raises:
        FileError: runs of other options than the experiment's, or not all of one length.
    """
    found = experiment.finished(search, start)
    if not found:
        return None
    first, rollouts = next((path, each["rollouts"]) for path, each in found.items())
    for path, each in found.items():
        if each["rollouts"] != rollouts:
            raise FileError(
                f"{path} has {len(each['rollouts']) - 1} updates and {first} has {len(rollouts) - 1}; runs that are shown "
                "together have to be of one length: remove one of them"
            )
    records = list(found.values())

    def together(columns: list[list[list[float]]]) -> list[list[float]]:
        return [[value for row in rows for value in row] for rows in zip(*columns, strict=True)]

    return History(
        rollouts=rollouts,
        cost=together([each["cost"] for each in records]),
        terms={name: together([each["terms"][name] for each in records]) for name in records[0]["terms"]},
    )


def budget(experiment: Experiment) -> int:
    """The roll-outs of a learning run: of those that are there, or as they are planned."""
    for which in product(SEARCHES, STARTS):
        if (curves := history(experiment, *which)) is not None:
            return curves.rollouts[-1]
    updates = SEARCH.n_updates if experiment.options.updates is None else experiment.options.updates
    return updates * (experiment.options.rollouts or SEARCH.n_rollouts)


def check(path: Path, content: Mapping[str, Any], options: RunOptions) -> None:
    """Refuse a file of another run, or of one with another number of updates.

    Raises:
        FileError: what differs.
    """
    check_identity(path, content, options)
    there, here = (SEARCH.n_updates if n is None else n for n in (content["options"].get("updates"), options.updates))
    if there != here:
        raise FileError(
            f"{path} was made with {there} updates, and the experiment has {here}; give --updates {there} to go on with it, or "
            "another --logdir"
        )
