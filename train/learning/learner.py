"""A learning run as an object: what is learned, what learns it, and what it has cost so far."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import torch

import tasks
from tasks.base import total
from torchds import Rollout
from train.folder import History
from train.options import RunOptions
from train.searchers.named import (
    add_noise,
    forward_equivalents,
    make_closure,
    make_decay,
    make_optimizer,
    n_failed,
    n_rollouts,
    n_updates,
)


class Learner:
    """Task, policies, optimizer and decay that a set of options names; `runs` policies learn in one batch.

    Args:
        options: the options.
        task: in place of the one that the options name.
    """

    def __init__(self, options: RunOptions, task: tasks.Task | None = None) -> None:
        self.options = options
        self.task = task if task is not None else tasks.make(options.task, **options.task_options())
        self.initial = self.task.policy()
        self.policy = self.initial.expand(options.runs)
        self.optim = make_optimizer(options, self.task, self.policy)
        self.decay = make_decay(options, self.task, self.optim)
        self.closure = make_closure(self.optim, self.task, self.policy)
        self.noise = torch.Generator().manual_seed(options.seed)
        if options.cost_noise:
            with torch.no_grad():
                std = options.cost_noise * float(total(self.task.evaluate(self.initial)[1].values()))
            self.closure = add_noise(self.closure, std, getattr(self.optim, "costs_per_step", False), self.noise)
        self.n_updates = n_updates(options, self.task) * n_rollouts(options, self.task) // self.optim.n_rollouts
        self.history = History()
        self.path: Rollout | None = None

    @property
    def done(self) -> int:
        """Updates made so far."""
        return max(len(self.history.cost) - 1, 0)

    def start(self) -> None:
        """Evaluate the initial policy, once."""
        if not self.history.cost:
            self.history.add(0, self.evaluate(), 0, forward_equivalents(self.options, self.optim, 0))

    def update(self) -> float:
        """One update and a noise-free evaluation; returns the seconds it took."""
        began = time.perf_counter()
        self.optim.step(self.closure)
        if self.decay is not None:
            self.decay.step()
        updates = self.done + 1
        computed = forward_equivalents(self.options, self.optim, updates)
        self.history.add(updates * self.optim.n_rollouts, self.evaluate(), n_failed(self.optim), computed)
        seconds = time.perf_counter() - began
        self.history.seconds += seconds
        return seconds

    def learn(self) -> Learner:
        """All updates at once, with nothing written."""
        self.start()
        while self.done < self.n_updates:
            self.update()
        return self

    @torch.no_grad()
    def evaluate(self) -> dict[str, torch.Tensor]:
        """The cost terms of a noise-free trial of the present policies, whose roll-out is kept in `path`."""
        self.path, terms = self.task.evaluate(self.policy)
        return terms

    def state_dict(self) -> dict[str, Any]:
        """Everything that a checkpoint needs to continue bit for bit."""
        return {
            "policy": self.policy.state_dict(),
            "optimizer": self.optim.state_dict(),
            "decay": None if self.decay is None else self.decay.state_dict(),
            "noise": self.noise.get_state(),
            "task": self.task.state_dict(),
            "history": asdict(self.history),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.policy.load_state_dict(state["policy"])
        self.optim.load_state_dict(state["optimizer"])
        self.noise.set_state(state["noise"])
        if self.decay is not None:
            self.decay.load_state_dict(state["decay"])
        self.task.load_state_dict(state["task"])
        self.history = History(**state["history"])
