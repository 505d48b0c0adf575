"""How fast learning is: `python -m train benchmark`."""

from __future__ import annotations

from dataclasses import dataclass

from tqdm import tqdm

from train.learning import Learner
from train.options import ViaPointOptions
from train.records import versions


@dataclass
class Benchmark:
    """Time batched learning of the N-shape on one core: 50 updates, with a noise-free evaluation after each."""

    repeats: int = 5
    """How often each is timed; the median is printed."""
    updates: int = 50
    """Policy updates."""

    def main(self) -> None:
        """Time 20 runs and one run, and print both with machine and versions."""
        rows = {runs: [self.seconds(runs) for _ in tqdm(range(self.repeats), desc=f"{runs} runs")] for runs in (20, 1)}
        print(", ".join(f"{name} {value}" for name, value in versions().items()))
        for runs, times in rows.items():
            median = sorted(times)[len(times) // 2]
            print(f"{runs:3d} runs x {self.updates} updates: median {median:.2f} s, min {min(times):.2f} s (one core)")

    def seconds(self, runs: int) -> float:
        """Wall time of learning, without the EM fit before it."""
        learner = Learner(ViaPointOptions(runs=runs, updates=self.updates))
        return learner.learn().history.seconds
