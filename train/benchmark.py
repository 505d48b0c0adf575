"""How fast learning is: `python -m train benchmark`."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch
from tqdm import tqdm

import tasks
from train.options import ViaPointOptions
from train.records import versions
from train.searchers import make_closure, make_decay, make_optimizer


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
        options = ViaPointOptions(runs=runs)
        task = tasks.make("via_point")
        policy = task.policy().expand(runs)
        optim = make_optimizer(options, task, policy)
        decay = make_decay(options, task, optim)
        closure = make_closure(optim, task, policy)
        began = time.perf_counter()
        for _ in range(self.updates):
            optim.step(closure)
            decay.step()
            with torch.no_grad():
                task.evaluate(policy)
        return time.perf_counter() - began
