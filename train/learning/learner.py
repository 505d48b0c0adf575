"""A learning run as an object: what is learned, what learns it, and what it has cost so far."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import torch

import tasks
from tasks.base import total
from torchds import GMRPolicy, Rollout
from torchds.errors import InvalidArgumentError, TorchdsError
from train.learning.history import History
from train.options import RunOptions
from train.searchers.base import Closure, by_chance, noisy
from train.searchers.named import Explore, make_searcher, n_updates


class Learner:
    """Task, policies and searcher that a set of options names; `runs` policies learn in one batch.

    Args:
        options: the options.
        task: in place of the one that the options name.
        wrap: `wrap(closure, learner)` returns what the searcher calls in place of `closure`: to watch the trials, or to try
            the policies in another way. The learner stands by then, and `restart` calls it again.
        exploration: `exploration(task, policy)` makes the noise of the `(runs,)` policies, in place of the one that the
            options name.

    Attributes:
        initial: the policy before learning.
        policy: `(runs,)` policies, as they have been learned.
        searcher: what changes them.
        closure: what the searcher calls.
        n_updates: updates that the budget pays for.
        history: what all updates led to.
        path: the last noise-free trial; None before the first.
    """

    def __init__(
        self,
        options: RunOptions,
        task: tasks.Task | None = None,
        *,
        wrap: Callable[[Closure, Learner], Closure] | None = None,
        exploration: Explore | None = None,
    ) -> None:
        self.options = options
        self.task = task if task is not None else options.make_task()
        self.wrap, self.exploration = wrap, exploration
        self.initial = self.task.policy()
        self.policy = self.initial.expand(options.runs)
        self.noise = torch.Generator().manual_seed(options.seed)  # of trials and their costs
        self.searcher = make_searcher(options, self.task, self.policy, exploration)
        self.closure = self._closure()
        self.n_updates = n_updates(options, self.task, self.searcher)
        self.history = History()
        self.path: Rollout | None = None

    def _closure(self) -> Closure:
        """Trials of the policies as the searcher wants them, with noise in their costs, wrapped."""
        closure = by_chance(self.searcher.closure(self.task, self.policy), self.task, self.noise)
        if self.options.cost_noise:
            with torch.no_grad():
                std = self.options.cost_noise * float(total(self.task.evaluate(self.initial)[1].values()))
            closure = noisy(closure, std, self.searcher.costs_per_step, self.noise)
        return closure if self.wrap is None else self.wrap(closure, self)

    def restart(self, policy: GMRPolicy) -> None:
        """Go on with other policies `(runs,)`, say with more Gaussians; noise, its width and its decay go on where they are.

        Raises:
            InvalidArgumentError: the searcher cannot (see `Searcher.follow`).
        """
        searcher = make_searcher(self.options, self.task, policy, self.exploration)
        searcher.follow(self.searcher)
        self.policy, self.searcher = policy, searcher
        self.closure = self._closure()

    @property
    def done(self) -> int:
        """Updates made so far."""
        return max(len(self.history.cost) - 1, 0)

    def start(self) -> None:
        """Evaluate the initial policy, once."""
        if not self.history.cost:
            self.history.add(0, self.evaluate(), 0, self.searcher.forward_equivalents(0))

    def update(self) -> float:
        """One update and a noise-free evaluation; returns the seconds it took."""
        began = time.perf_counter()
        searcher, updates = self.searcher, self.done + 1
        searcher.step(self.closure)
        computed = searcher.forward_equivalents(updates)
        self.history.add(updates * searcher.n_rollouts, self.evaluate(), searcher.failed, computed)
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
            "initial": self.initial.state_dict(),
            "policy": self.policy.state_dict(),
            "searcher": self.searcher.state_dict(),
            "noise": self.noise.get_state(),
            "task": self.task.state_dict(),
            "history": asdict(self.history),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken.

        Raises:
            InvalidArgumentError: a state of other policies or another searcher, or a history that is not one; the learner is
                of no further use.
        """
        try:
            history = History.of(state["history"], self.options.runs)
            for name, value in self.initial.state_dict().items():
                if not torch.allclose(value, state["initial"][name].to(value), rtol=1e-6, atol=1e-9, equal_nan=True):
                    raise InvalidArgumentError(
                        "it began with another policy: demonstrations or mixture have changed since"
                    )
            self.policy.load_state_dict(state["policy"])
            self.searcher.load_state_dict(state["searcher"])
            self.noise.set_state(state["noise"])
            self.task.load_state_dict(state["task"])
        except (KeyError, IndexError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            said = str(error) if isinstance(error, TorchdsError) else f"{type(error).__name__}: {error}"
            raise InvalidArgumentError(" ".join(said.split())) from error
        self.history = history
