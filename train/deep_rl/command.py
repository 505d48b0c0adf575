"""Deep reinforcement learning on a task: `python -m train deep_rl ViaPointN --optimizer ppo`."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch
import tyro
from torch import Tensor
from tqdm import tqdm

import tasks
from tasks import ENVIRONMENTS
from tasks.base import total
from torchds.errors import InvalidArgumentError
from torchds.monitor import of_costs
from torchds.monitor.events import Events
from train.folder import Interrupted, RunFolder
from train.learning.history import History, results, table
from train.options import check_seed

EVALUATIONS = 50  # at most, besides the first; a trial takes as long as a tenth of an update


@dataclass
class DeepRL:
    """Learn a task with PPO or SAC: a small net that corrects the demonstrated policy at every time step.

    The budget is counted in roll-outs (episodes), as for all other optimizers; by default it is the task's own. The cost is
    that of the deterministic policy, without a control cost: there is no θ that it could be of.
    """

    environment: tyro.conf.Positional[
        Literal["ViaPointN", "ViaPointP", "TwoStarts", "DivergentField", "HalfPlaneForce", "ConstrainedReaching"]
    ]
    """The task, as `torchds/<this>-v0` in Gymnasium."""
    optimizer: Literal["ppo", "sac"] = "ppo"
    """ppo: proximal policy optimization. sac: soft actor-critic."""
    runs: int = 3
    """Independent runs, one after the other."""
    seed: int = 0
    """Of the first run; the others count up."""
    updates: int | None = None
    """Batches of roll-outs; the task's number of updates if not given."""
    rollouts: int | None = None
    """Roll-outs in a batch; the task's own number if not given."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where runs write: LOGDIR/<task>/<optimizer>/<time>-<seed>/."""

    @property
    def task(self) -> str:
        """The name of the task."""
        return ENVIRONMENTS[self.environment][0]

    def task_options(self) -> dict[str, Any]:
        """The options that go to `tasks.make`."""
        return dict(ENVIRONMENTS[self.environment][1])

    def to_json(self) -> dict[str, Any]:
        """Plain values, the options of the task among them."""
        return {**asdict(self), "logdir": str(self.logdir), **self.task_options()}

    def main(self) -> Path:
        """Learn, log, and return the folder of the run.

        Raises:
            MissingPackageError: without the extra "baselines".
            InvalidArgumentError: options that do not fit.
            Interrupted: from the keyboard; a run cannot be resumed.
        """
        from train.deep_rl import agents

        for name in ("runs", "updates", "rollouts"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InvalidArgumentError(f"--{name} has to be at least 1, got {value}")
        check_seed(self.seed, bits=31)
        task = tasks.make(self.task, **self.task_options())
        n_updates = self.updates or task.search.n_updates
        n_rollouts = self.rollouts or task.search.n_rollouts
        run = RunFolder.new(self.logdir, self.task, self.optimizer, self.seed)
        run.begin(self.task, self.to_json())
        folder = run.path
        print(f"{self.environment}: {self.runs} run(s) of {self.optimizer}, logs in {folder}")
        curves: dict[int, list[dict[str, Tensor]]] = {}  # the terms of each run, by update
        began = time.perf_counter()
        bar = tqdm(total=self.runs * n_updates, unit="update", dynamic_ncols=True)

        def report(update: int, terms: dict[str, Tensor] | None) -> None:
            if terms is not None:
                curves.setdefault(update, []).append(terms)
                bar.set_postfix_str(f"cost {float(total(terms.values())):.4g}", refresh=False)
            bar.update(update > 0)

        try:
            for seed in range(self.seed, self.seed + self.runs):
                agent, normalized = agents.learn(
                    self.optimizer,
                    task,
                    n_updates=n_updates,
                    n_rollouts=n_rollouts,
                    seed=seed,
                    every=max(n_updates // EVALUATIONS, 1),
                    report=report,
                )
                agents.save(folder, seed, agent, normalized)
        except KeyboardInterrupt:
            raise Interrupted(f"stopped; {folder} has the agents that were ready") from None
        finally:
            bar.close()
        history = History(seconds=time.perf_counter() - began)
        with Events(folder) as events:
            events.charts()
            for update, runs in curves.items():
                terms = {name: torch.stack([run[name] for run in runs]) for name in runs[0]}
                history.add(update * n_rollouts, terms, failed=0, forward_equivalents=update * n_rollouts)
                events.scalars(of_costs(terms) | {"rollouts/updates": update}, history.rollouts[-1])
        run.write_results(results(self.task, self.to_json(), history))
        print(table(history))
        print(f"{history.rollouts[-1]} roll-outs per run in {history.seconds:.1f} s; agents and results in {folder}")
        return folder
