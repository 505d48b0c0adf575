"""The whole digging experiment (section 6): learning from two stiffnesses, and the uniform ones to compare with.

Everything stands in one folder; what is there is not measured again, so that the experiment can be interrupted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

import tasks
from torchds import GMRPolicy
from torchds.files import read_sealed, write_sealed
from train.folder import OPTIONS, RESULTS, RunFolder, check_identity, numbers, say_versions, versions
from train.learning.learner import Learner
from train.learning.run import run
from train.options import LEARNERS, RunOptions, options_for

STARTS = (150.0, 400.0)  # N/m
PAPER = "as in the paper"  # the learner that the claims are about
SEARCHES: dict[str, dict[str, Any]] = {PAPER: LEARNERS["pibb"], "recommended": LEARNERS["recommended"]}
UNIFORM = (75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0)  # N/m
TRIALS = 5
TRIALS_FILE = "trials.json"
TRIALS_SEED = 1000  # of the beds of the comparison, which no learning run has met
Terms = dict[str, list[float]]


class Experiment:
    """Learning runs and measured trials in a folder.

    Args:
        folder: where everything stands.
        seed: of the learning runs.
        options: of the scene and of learning; initial stiffness, learner and seed are those of the experiment.
    """

    def __init__(self, folder: Path, seed: int, options: RunOptions | None = None) -> None:
        self.folder, self.seed = folder, seed
        self.options = options if options is not None else options_for("lwr_digging")

    def run_folder(self, search: str, start: float) -> RunFolder:
        """Where one learning run stands, or would stand."""
        return RunFolder(self.folder / f"{SEARCHES[search]['optimizer']}-{start:g}")

    def recorded(self) -> dict[str, Terms]:
        """The trials that are there.

        Raises:
            FileError: they are damaged, or were measured with other options.
        """
        path = self.folder / TRIALS_FILE
        if not path.is_file():
            return {}
        content = read_sealed(path, unsealed=("trials", "versions"))
        if "options" in content:
            check_identity(path, content, self.options)
            say_versions(path, content["versions"])
        return numbers(content["trials"])

    def finish(self, search: str, start: float) -> RunFolder:
        """Make, continue or find finished one learning run; returns its folder."""
        folder = self.run_folder(search, start)
        options = replace(self.options, **{**SEARCHES[search], "initial_stiffness": start, "seed": self.seed})
        if not folder.has(OPTIONS):
            folder.begin(options.task, options.to_json())
        if not folder.has(RESULTS):
            run(replace(options, resume=folder.path))
        else:
            check_identity(folder.path / RESULTS, folder.results(), options)
        return folder

    def learned(self, search: str, start: float) -> Learner:
        """One learning run, finished."""
        folder = self.finish(search, start)
        finished = Learner(folder.options())
        folder.restore(finished)
        return finished

    def trials(self) -> dict[str, Terms]:
        """Costs of TRIALS trials `[TRIALS]` by term, "total" among them, of every uniform stiffness and learned policy."""
        with RunFolder(self.folder).alone():
            return self._trials()

    def _trials(self) -> dict[str, Terms]:
        measured = self.recorded()
        runs = {f"{search}-{start:g}": (search, start) for search in SEARCHES for start in STARTS}
        wanted = [f"uniform-{s:g}" for s in UNIFORM] + list(runs)
        for name in tqdm([name for name in wanted if name not in measured], desc="trials", unit="policy"):
            if name in runs:
                search, start = runs[name]
                measured[name] = self.measure(start, self.learned(search, start).policy[0])
            else:
                measured[name] = self.measure(float(name.removeprefix("uniform-")), None)
            said = {"task": self.options.task, "options": self.options.to_json(), "versions": versions()}
            write_sealed(self.folder / TRIALS_FILE, {**said, "trials": measured})
        return measured

    def measure(self, start: float, policy: GMRPolicy | None) -> Terms:
        """TRIALS trials of a policy, or of the imitated one with the uniform stiffness `start`, on the same beds for all."""
        task = tasks.make(
            "lwr_digging", **{**self.options.task_options(), "initial_stiffness": start, "seed": TRIALS_SEED}
        )
        path, terms = task.evaluate((task.policy() if policy is None else policy).expand(TRIALS))
        shown = {**terms, "total": torch.stack(list(terms.values())).sum(0), **task.diagnostics(path)}
        return {name: values.tolist() for name, values in shown.items()}


def best_uniform(trials: dict[str, Terms]) -> str:
    """The name of the uniform stiffness with the lowest mean cost."""
    return min((name for name in trials if name.startswith("uniform")), key=lambda name: np.mean(trials[name]["total"]))


def uniform_trials(experiment: Experiment, stiffness: float) -> Terms | None:
    """Trials of the imitated motion with a uniform stiffness [N/m]; None where they are not there."""
    return experiment.recorded().get(f"uniform-{stiffness:g}")


def learned_trials(experiment: Experiment, start: float) -> Terms | None:
    """Trials of what the paper's learner made of a uniform stiffness [N/m]; None where they are not there."""
    return experiment.recorded().get(f"{PAPER}-{start:g}")


def curves(experiment: Experiment, start: float) -> dict[str, np.ndarray] | None:
    """The noise-free cost terms `(U+1,)` of the paper's learner from a uniform stiffness; None where they are not there."""
    folder = experiment.run_folder(PAPER, start)
    if not folder.has(RESULTS):
        return None
    return {name: np.asarray(values, dtype=float)[:, 0] for name, values in folder.results()["terms"].items()}
