"""Sections 4.2 and 4.3: stable exploration of a constrained reach (Figs 6 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import tasks
from torchds import GMRPolicy
from torchds.exploration import Exploration, Gaussian, Homogeneous, Stable
from torchds.exploration.homogeneous import chi_mean
from train.learning.learner import Learner
from train.options import options_for
from train.searchers.base import Closure

TASK = "constrained_reaching"
LEVELS = (0.01, 0.02, 0.03, 0.05, 0.1)  # standard deviations of the noise of A [1/s]
SHOWN = 0.05  # the task's own level, that of the learning curves
EARLY, LATE = 10, 40  # updates: 100 and 400 roll-outs
STABLE, TIED, FREE, HOMOGENEOUS = "stable", "b tied only", "free A and b", "homogeneous"
ALONG, SCHEDULED = "stable, along the motion", "stable, same decay and temperature"


class Watched(NamedTuple):
    """Learning runs of stable exploration, with a certificate of every roll-out and every update.

    Attributes:
        learner: finished.
        tried: roll-outs that satisfied the condition, and all.
        reached: policies after an update that did, and all.
    """

    learner: Learner
    tried: tuple[int, int]
    reached: tuple[int, int]


def certified(learner: Learner) -> Tensor:
    """Whether the present policies `(*batch)` satisfy the stability condition."""
    return learner.policy.certificate(learner.task.scene().goal, learner.task.P).stable


@cache
def watched(runs: int, seed: int) -> Watched:
    """The constrained reach, learned under watch."""
    tried, reached = [], []

    def watch(closure: Closure, learner: Learner) -> Closure:
        def watching() -> Tensor:
            tried.append(certified(learner))
            return closure()

        return watching

    learner = Learner(options_for("constrained_reaching", runs=runs, seed=seed), wrap=watch)
    learner.start()
    while learner.done < learner.n_updates:
        learner.update()
        reached.append(certified(learner))

    def count(parts: Sequence[Tensor]) -> tuple[int, int]:
        return int(sum(part.sum() for part in parts)), sum(part.numel() for part in parts)

    return Watched(learner, count(tried), count(reached))


class Variant(NamedTuple):
    """What an exploration made of the task, at all levels of noise in one batch.

    Attributes:
        cost: `(U+1, levels, runs)` of the noise-free policies.
        stable: `(levels,)` final policies that satisfy the condition.
        colliding: `(levels,)` final policies that collide.
        share: `(levels, runs)` of the roll-outs, over the whole learning, that collide.
    """

    cost: np.ndarray
    stable: list[int]
    colliding: list[int]
    share: np.ndarray


def exploration_of(task: tasks.Task, policy: GMRPolicy, name: str, std: Tensor) -> Exploration:
    """The exploration of a variant, for the standard deviation `(runs,)` of each run of the batch."""
    goal = task.scene().goal
    if name in (STABLE, TIED, SCHEDULED):
        raw = Gaussian([std[:, None, None, None], 0.0])
        return Stable(policy, raw, goal, task.P, shrink="none" if name == TIED else "all")
    with torch.no_grad():
        initial = task.policy()
        x = task.rollout(initial).x
        distance = (x - goal).norm(dim=-1)
        if name == FREE:  # the noise of b is as fast as that of A is on the motion
            return Gaussian([std[:, None, None, None], (std * x.square().sum(-1).mean().sqrt())[:, None, None]])
        # As fast, on average over the motion, as tied noise of standard deviation `std`.
        h = initial.gating(x)
        speed = chi_mean(2) * (h.square().sum(-1).sqrt() * distance).mean()
        unit = Homogeneous(initial, mean_speed=1.0).std()
        features = torch.cat([x.square(), torch.ones_like(x[:, :1])], -1)[:, None]  # (T+1, 1, 3)
        variances = torch.cat([unit["A"][:, 0], unit["b"][:, :1]], -1)  # (K, 3), alike for both outputs
        unit_speed = chi_mean(2) * (h.square() * (features * variances.square()).sum(-1)).sum(-1).sqrt().mean()
        factor = std * speed / unit_speed
        return Gaussian([factor[:, None, None, None] * unit["A"], factor[:, None, None] * unit["b"]])


@cache
def variant(name: str, runs: int, seed: int) -> Variant:
    """One exploration of Fig. 8, at all levels of noise, `runs` runs each."""
    task = tasks.make(TASK)
    levels = (SHOWN,) if name in (ALONG, SCHEDULED) else LEVELS
    options: dict[str, Any] = {"exploration": "stable-trajectory"} if name == ALONG else {}
    if name == SCHEDULED:
        options = {"temperature": "capped", "decay": "exponential"}
    std = torch.tensor(levels, dtype=torch.float64).repeat_interleave(runs)
    collisions = []

    def watch(closure: Closure, learner: Learner) -> Closure:
        def watching() -> Tensor:
            path = task.rollout(learner.policy)
            collisions.append(path.stopped.double().mean(0))
            return task.cost(path)

        return watching

    learner = Learner(
        options_for("constrained_reaching", runs=len(levels) * runs, seed=seed, **options),
        task,
        wrap=watch,
        exploration=None if name == ALONG else lambda task, policy: exploration_of(task, policy, name, std),
    ).learn()
    by_level = (len(levels), runs)
    return Variant(
        np.asarray(learner.history.cost).reshape(-1, *by_level),
        certified(learner).reshape(by_level).sum(-1).tolist(),
        task.rollout(learner.policy).stopped.reshape(by_level).sum(-1).tolist(),
        torch.stack(collisions).mean(0).reshape(by_level).numpy(),
    )
