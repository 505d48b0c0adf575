"""How fast learning is: `python -m train benchmark`."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from typing import Any

from tqdm import tqdm

import tasks
from torchds.exploration import TrajectorySpace
from train.folder import versions
from train.learning.learner import Learner
from train.options import options_for


@dataclass
class Benchmark:
    """Time learning of the N-shape on one core: 20 runs in a batch, one run, and the exploration along the motion."""

    repeats: int = 5
    """How often each is timed; the median is printed."""
    updates: int = 50
    """Policy updates."""
    digging: float = 15.0
    """Seconds of eight digging roll-outs, to see where their time goes; 0 for none."""

    def main(self) -> None:
        """Time 20 runs and one run, and print both with machine and versions."""
        rows = {runs: [self.seconds(runs) for _ in tqdm(range(self.repeats), desc=f"{runs} runs")] for runs in (20, 1)}
        print(", ".join(f"{name} {value}" for name, value in versions().items()))
        for runs, times in rows.items():
            median = statistics.median(times)
            print(f"{runs:3d} runs x {self.updates} updates: median {median:.2f} s, min {min(times):.2f} s (one core)")
        for runs in (20, 1):
            refresh, rollouts = self.refresh(runs)
            print(
                f"{runs:3d} runs: TrajectorySpace refreshes in {1e3 * refresh:.1f} ms; the ten roll-outs it serves, with cost "
                f"and update, take {1e3 * rollouts:.1f} ms (medians)"
            )

        if self.digging:
            control, physics = self.split()
            print(
                f"8 digging roll-outs of {self.digging:g} s: {control + physics:.1f} s on 2 threads; controller "
                f"{control:.1f} s ({100 * control / (control + physics):.0f} %), MuJoCo {physics:.1f} s"
            )

    def split(self) -> tuple[float, float]:
        """Seconds that policy, kinematics, impedance law and bookkeeping take in a batch of digging roll-outs, and physics."""
        task: Any = tasks.make("lwr_digging", seconds=self.digging)
        policies, worlds = task.policy().expand(8), task.worlds(8)
        began = time.perf_counter()
        task.cost(task.rollout(policies))
        return time.perf_counter() - began - worlds.seconds["physics"], worlds.seconds["physics"]

    def refresh(self, runs: int) -> tuple[float, float]:
        """Median seconds of one evaluation of the covariance, and of one update with homogeneous noise."""
        learner = Learner(options_for("via_point", runs=runs, updates=self.updates))
        along = TrajectorySpace(learner.policy, *learner.task.motion(), spread=0.5)
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(4 * self.repeats):
            for column, call in zip(
                times, (along.refresh_now, lambda: learner.searcher.step(learner.closure)), strict=True
            ):
                began = time.perf_counter()
                call()
                column.append(time.perf_counter() - began)
        return statistics.median(times[0]), statistics.median(times[1])

    def seconds(self, runs: int) -> float:
        """Wall time of learning, without the EM fit before it."""
        learner = Learner(options_for("via_point", runs=runs, updates=self.updates))
        return learner.learn().history.seconds
