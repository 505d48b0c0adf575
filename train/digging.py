"""The whole digging experiment (section 6): learning from two stiffnesses, and the uniform ones to compare with.

Everything stands in one folder; what is there is not measured again, so that the experiment can be interrupted.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import tasks
from torchds import GMRPolicy
from train.learning import Learner
from train.options import Exploration, LwrDiggingOptions
from train.records import versions, write_json
from train.run import OPTIONS, RESULTS, run

STARTS = (150.0, 400.0)  # N/m
EXPLORATIONS: tuple[Exploration, ...] = ("homogeneous", "trajectory")
UNIFORM = (75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0)  # N/m
TRIALS = 5
TRIALS_SEED = 1000  # of the beds of the comparison, which no learning run has met
Terms = dict[str, list[float]]


class Experiment:
    """Learning runs and measured trials in a folder.

    Args:
        folder: where everything stands.
        seed: of the learning runs.
        options: of the scene and of learning; initial stiffness, exploration and seed are those of the experiment.
    """

    def __init__(self, folder: Path, seed: int, options: LwrDiggingOptions | None = None) -> None:
        self.folder, self.seed = folder, seed
        self.options = options if options is not None else LwrDiggingOptions()

    def learned(self, exploration: Exploration, start: float) -> Path:
        """The folder of one learning run, which is made, continued or found finished."""
        folder = self.folder / f"{exploration}-{start:g}"
        options = replace(self.options, exploration=exploration, initial_stiffness=start, seed=self.seed)
        if not (folder / OPTIONS).is_file():
            folder.mkdir(parents=True, exist_ok=True)
            write_json(folder / OPTIONS, {"task": options.task, "options": options.to_json()})
        return folder if (folder / RESULTS).is_file() else run(replace(options, resume=folder))

    def learner(self, exploration: Exploration, start: float) -> Learner:
        """The finished run, as an object."""
        folder = self.learned(exploration, start)
        content = json.loads((folder / OPTIONS).read_text())
        learner = Learner(LwrDiggingOptions.from_json(content["options"]))
        learner.load_state_dict(torch.load(folder / "checkpoint.pt", weights_only=True))
        return learner

    def trials(self) -> dict[str, Terms]:
        """Costs of TRIALS trials `[TRIALS]` by term, "total" among them, of every uniform stiffness and learned policy."""
        path = self.folder / "trials.json"
        content = json.loads(path.read_text()) if path.is_file() else {}
        measured: dict[str, Terms] = content.get("trials", {})
        runs = {f"{exploration}-{start:g}": (exploration, start) for exploration in EXPLORATIONS for start in STARTS}
        wanted = [f"uniform-{s:g}" for s in UNIFORM] + list(runs)
        for name in tqdm([name for name in wanted if name not in measured], desc="trials", unit="policy"):
            if name in runs:
                exploration, start = runs[name]
                policy = self.learner(exploration, start).policy[0]
            else:
                start = float(name.removeprefix("uniform-"))
                policy = None
            measured[name] = self.measure(start, policy)
            write_json(path, {"trials": measured, "versions": versions()})
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
