"""Many workers, simulated: how long an update takes that does not wait for the last of them, and what it then learns.

A worker makes one roll-out of an update. Its time is drawn from a lognormal distribution with the mean and the spread of those
that were measured; with some probability the worker fails, and nothing ever comes. An update begins when a share of the
roll-outs, `min_share`, has come; what is missing counts as failed, and its worker begins anew. A worker that fails while all
are waited for is missed after `patience`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from train.learning.kept import made
from train.learning.learner import Learner
from train.options import RunOptions
from train.searchers.base import Closure


class Times(NamedTuple):
    """What is known about one roll-out.

    Attributes:
        mean: of its time [s].
        spread: standard deviation of the logarithm of its time.
        failure: probability that nothing comes of it.
    """

    mean: float
    spread: float
    failure: float

    @classmethod
    def of(cls, seconds: np.ndarray, failure: float) -> Times:
        """Those of roll-outs that were measured, `(M,)` [s]."""
        return cls(float(seconds.mean()), float(np.log(seconds).std()), failure)

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """Times [s]; infinite where the worker failed."""
        seconds = rng.lognormal(np.log(self.mean) - 0.5 * self.spread**2, self.spread, shape)
        return np.where(rng.random(shape) < self.failure, np.inf, seconds)


def update_seconds(
    times: Times, workers: int, min_share: float, patience: float, updates: int, rng: np.random.Generator
) -> np.ndarray:
    """`(updates,)` how long each update waits for its roll-outs [s].

    Args:
        times: of one roll-out.
        workers: W, one roll-out each.
        min_share: of the roll-outs that is waited for, 0 < min_share ≤ 1.
        patience: after which a worker counts as failed [s].
        updates: how many are drawn.
        rng: draws them.
    """
    needed = max(1, int(np.ceil(min_share * workers - 1e-9)))
    waits = [np.partition(times.draw((workers,), rng), needed - 1)[needed - 1] for _ in range(updates)]
    return np.minimum(waits, patience)


def gather_seconds(processes: int, size: float, latency: float, bandwidth: float) -> float:
    """How long a gather takes in which everybody gets everything, by a ring: (W − 1) (latency + bytes/bandwidth) [s].

    Args:
        processes: W.
        size: what each sends [bytes].
        latency: of a message [s].
        bandwidth: of a process [bytes/s].
    """
    return (processes - 1) * (latency + size / bandwidth)


def final_costs(options: RunOptions, wrap: Callable[[Closure, Learner], Closure]) -> np.ndarray:
    """`(runs,)` costs after learning with trials that `wrap` changes."""
    return np.asarray(Learner(options, made(options), wrap=wrap).learn().history.cost[-1])


def lossy(share: float, seed: int) -> Callable[[Closure, Learner], Closure]:
    """Trials of which only a share comes in time, whichever they are: the first that do are no better than the others."""
    generator = torch.Generator().manual_seed(seed)

    def wrap(closure: Closure, learner: Learner) -> Closure:
        def some() -> Tensor:
            costs = closure()
            n = max(1, round(share * len(costs)))
            order = torch.rand(costs.shape, generator=generator).argsort(0)
            return costs.masked_fill(order >= n, torch.inf)

        return some

    return wrap


def stale(updates: int) -> Callable[[Closure, Learner], Closure]:
    """Trials around parameters as they were some updates ago, by workers who do not wait for the newest."""

    def wrap(closure: Closure, learner: Learner) -> Closure:
        parameters = list(learner.policy.parameters())
        past: deque[list[Tensor]] = deque(maxlen=updates + 1)

        def around_old_ones() -> Tensor:
            assert learner.searcher.optim is not None
            state = learner.searcher.optim.state
            now = [p.data - state[p]["noise"] for p in parameters]
            past.append(now)
            moved(parameters, (old - new for old, new in zip(past[0], now, strict=True)))
            return closure()

        return around_old_ones

    return wrap


def moved(parameters: Iterable[nn.Parameter], by: Iterable[Tensor]) -> None:
    """Move the parameters that are being tried; whoever tries them brings them back."""
    for p, shift in zip(parameters, by, strict=True):
        p.data = p.data + shift


def rollout_seconds(options: RunOptions, trials: int) -> list[float]:
    """How long trials of noisy policies take on a core of their own, which others may use meanwhile: processor time [s]."""
    learner, seconds = Learner(options), list[float]()
    optim = learner.searcher.optim
    assert optim is not None
    while len(seconds) < trials:
        optim.ask()
        noise = {p: optim.state[p]["noise"] for p in learner.policy.parameters()}
        for n in range(optim.n_rollouts):
            policy = learner.task.policy().expand(1)
            with torch.no_grad():
                for p, epsilon in zip(policy.parameters(), noise.values(), strict=True):
                    p.add_(epsilon[n])
            began = time.process_time()
            learner.task.rollout(policy)
            seconds.append(time.process_time() - began)
    return seconds[:trials]
