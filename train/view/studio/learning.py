"""A learning run that can be watched, stopped and continued, in a process of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tasks import Task
from torchds import GMRPolicy, Rollout
from train.folder import CHECKPOINT, RunFolder
from train.learning.learner import Learner
from train.learning.run import check, distinct
from train.statistics import of_costs
from train.view.studio.worker import Pipe, said

PICTURES = 40.0  # a second, at most
POINTS = 60  # of a path in a picture, about
SAVE_EVERY = 1.0  # s


class Picture(NamedTuple):
    """Where a learner stands.

    Attributes:
        done: updates so far.
        of: as many will be made.
        rollouts: spent by each run, after each update.
        curves: medians over runs after each update, by cost term, and of the total.
        trials: of the last update, `(N · runs, T', 2)` each, thinned; none before the first.
        motion: `(runs, T', 2)` of the policies as they are, thinned.
        policies: of all runs, `(runs,)`.
        best: the run with the lowest cost.
    """

    done: int
    of: int
    rollouts: list[int]
    curves: dict[str, list[float]]
    trials: list[Tensor]
    motion: Tensor
    policies: GMRPolicy
    best: int

    @property
    def policy(self) -> GMRPolicy:
        """That of the best run."""
        return self.policies[self.best]


def learn(pipe: Pipe, path: Path) -> None:
    """Learn the problem of the run in the folder, or go on where it was, and answer with pictures, or with `Failed`.

    Messages are `("go", updates a second)`, `("step", None)` and `("pause", None)`; it begins paused.
    """
    folder = RunFolder(path)

    def run() -> None:
        with folder.alone():
            Apprentice(pipe, folder).serve()

    if (failed := said(run)) is not None:
        pipe.send(failed)


def watched(task: Task) -> list[Rollout]:
    """The roll-outs of a task, as it makes them from now on."""
    paths: list[Rollout] = []
    make = task.rollout

    def rollout(policy: GMRPolicy) -> Rollout:
        paths.append(make(policy))
        return paths[-1]

    task.rollout = rollout  # type: ignore[method-assign]
    return paths


class Apprentice:
    """A learner that listens between two updates.

    Args:
        pipe: that it listens to.
        folder: of the run, which has its options; with a checkpoint it goes on from there.
    """

    def __init__(self, pipe: Pipe, folder: RunFolder) -> None:
        self.pipe, self.folder = pipe, folder
        options = folder.options()
        check(options)
        task = options.make_task()
        if not folder.has(CHECKPOINT):
            options = distinct(options, task)
            folder.begin(options.task, options.to_json())
        self.paths = watched(task)
        self.learner = Learner(options, task)
        folder.restore(self.learner)
        self.learner.start()
        if self.learner.path is None:
            self.learner.evaluate()
        self.pace = 0.0  # updates a second; 0 while it is paused
        self.saved = self.shown = -math.inf

    @property
    def finished(self) -> bool:
        """Whether the budget is spent."""
        return self.learner.done >= self.learner.n_updates

    def serve(self) -> None:
        """Until the pipe ends; whatever was learned by then is kept."""
        self.show()
        try:
            self._listen()
        finally:
            self.save()

    def _listen(self) -> None:
        due = time.monotonic()
        while True:
            if not self.pace or self.pipe.waits(max(due - time.monotonic(), 0.0)):
                word, pace = self.pipe.next()
                due = time.monotonic()
                self.pace = pace if word == "go" and not self.finished else 0.0
                if word == "step" and not self.finished:
                    self.update()
                self.show()
                continue
            due = max(due + 1.0 / self.pace, time.monotonic())
            self.update()
            if not self.pace or time.monotonic() - self.shown > 1.0 / PICTURES:
                self.show()

    def update(self) -> None:
        """One update, and a checkpoint from time to time."""
        self.paths.clear()
        self.learner.update()
        self.pace = 0.0 if self.finished else self.pace
        if time.monotonic() - self.saved > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Keep all of it."""
        self.folder.save_checkpoint(self.learner)
        self.saved = time.monotonic()

    def show(self) -> None:
        """Say where it stands; where it stands still, that is kept too."""
        self.shown = time.monotonic()
        if not self.pace:
            self.save()
        learner, history = self.learner, self.learner.history
        *trials, last = self.paths
        rows = {**history.terms, "total": history.cost}
        self.pipe.send(
            Picture(
                learner.done,
                learner.n_updates,
                list(history.rollouts),
                {name: of_costs(values, axis=1)[1].tolist() for name, values in rows.items()},
                [thinned(path.x) for path in trials],
                thinned(last.x),
                learner.policy,
                best(history.cost[-1]),
            )
        )


def thinned(x: Tensor) -> Tensor:
    """Some of the points of motions `(*batch, T+1, 2)`, the last one among them, as `(B, T', 2)` in single precision."""
    x = x.detach().reshape(-1, *x.shape[-2:]).float()
    every = torch.linspace(0, x.shape[1] - 1, min(POINTS, x.shape[1])).round().long()
    return x[:, every]


def best(costs: Sequence[float]) -> int:
    """The run with the lowest cost."""
    return int(np.nanargmin(costs)) if np.isfinite(costs).any() else 0
