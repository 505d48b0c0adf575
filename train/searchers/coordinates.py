"""Searchers over z in θ = θ₀ + L z: every method sees the same units, every trial is counted, every run resumes.

A method is a generator. It yields the points that it wants to try and is sent what they cost; nothing else happens to it.
So one record of answers, played to a new generator, brings any method back to where it was, bit for bit, whether its state
is in three tensors or deep in the stack of a library. Methods think on the CPU, wherever the trials are made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from tasks import Task
from tasks.base import total
from torchds import GMRPolicy
from torchds.arrays import shown
from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration
from torchds.optim.sharded import Sharded
from torchds.sharing import Share, trying
from train.searchers.base import GRADIENT_COST, JACOBIAN_COST, Closure, Searcher


class Brief(NamedTuple):
    """What a method is told at the start; it begins at z = 0.

    Attributes:
        runs: independent runs.
        P: entries of z, one for each entry of θ that is not frozen.
        n_rollouts: trials between two updates of methods that try several at once.
        scale: factor on the method's first step.
        seed: of all its randomness.
        noisy: whether a trial made again may cost another amount.
    """

    runs: int
    P: int
    n_rollouts: int
    scale: float
    seed: int
    noisy: bool = False


class Ask(NamedTuple):
    """What a method wants to try, and what it recommends so far: `(N, runs, P)` and `(runs, P)`."""

    z: Tensor
    answer: Tensor


class Answer(NamedTuple):
    """What the trials cost, `(N, runs)`, infinite where one failed; their gradients `(N, runs, P)` where asked for."""

    cost: Tensor
    gradient: Tensor | None


Asking = Generator[Ask, Answer, None]


class Method(NamedTuple):
    """A way to search.

    Attributes:
        begin: makes the generator.
        gradient: whether it needs gradients of the trials.
        random: whether its runs differ where the trials do not.
    """

    begin: Callable[[Brief], Asking]
    gradient: bool
    random: bool


@torch.no_grad()
def root(policy: GMRPolicy, exploration: Exploration) -> Tensor:
    """L `(*batch, P, F)` of an exploration that is linear in its normals: what it makes of each unit vector.

    F entries are free; frozen parameters (requires_grad=False) have rows of zeros and no unit vectors.
    """
    theta = policy.pack()
    P = theta.shape[-1]
    unit = torch.eye(P, dtype=theta.dtype, device=theta.device)[free_entries(policy)]
    unit = unit.reshape(-1, *(1,) * len(policy.batch_shape), P).expand(-1, *theta.shape)
    parts = policy.split(unit)
    names, parameters = zip(*policy.named_parameters(), strict=True)
    noise = exploration(parameters, [parts[name] for name in names])
    kept = [e if p.requires_grad else torch.zeros_like(e) for p, e in zip(parameters, noise, strict=True)]
    return policy.join(dict(zip(names, kept, strict=True))).movedim(0, -1)


def free_entries(policy: GMRPolicy) -> Tensor:
    """`(P,)` bool: which entries of θ may move.

    Raises:
        InvalidArgumentError: none.
    """
    free = policy.pack(lambda p: torch.full_like(p, float(p.requires_grad)))
    free = free.reshape(-1, free.shape[-1])[0] > 0
    if not free.any():
        raise InvalidArgumentError("all parameters are frozen; free those that shall be learned with requires_grad_()")
    return free


class CoordinateSearch(Searcher):
    """Steps a method over z.

    Args:
        policy: `(runs,)` policies, whose present parameters are θ₀.
        exploration: gives L, once: one unit of z is one standard deviation of its noise.
        method: the method.
        brief: for the method.
        jacobian: whether the exploration looked at the motion to find L.

    Attributes:
        n_rollouts: trials of one `step`: the least number, not below the brief's, that the method can stop at.
        mean_cost: `(runs,)` of the trials of the last step that did not fail; None before the first.
    """

    def __init__(
        self,
        policy: GMRPolicy,
        exploration: Exploration,
        method: Method,
        brief: Brief,
        *,
        jacobian: bool = False,
    ) -> None:
        self.policy, self.method, self.brief, self.jacobian = policy, method, brief, jacobian
        self.center, self.L = policy.pack().detach().clone(), root(policy, exploration)
        self._asking: Asking
        self._asked: Ask
        self._answers: list[Answer]
        self._begin()
        self.n_rollouts = len(self._asked.z) * math.ceil(brief.n_rollouts / len(self._asked.z))
        self.mean_cost: Tensor | None = None
        self._failed = 0

    @property
    def failed(self) -> int:
        """Trials of the last step without a finite cost, all runs together."""
        return self._failed

    def closure(self, task: Task, policy: GMRPolicy) -> Closure:
        """Trials with their whole cost, the control cost included."""
        return lambda: total(task.evaluate(policy)[1].values())

    def forward_equivalents(self, updates: int) -> int:
        """The trials, those with gradients dearer, and the Jacobian once."""
        each = self.n_rollouts * (GRADIENT_COST if self.method.gradient else 1)
        return updates * each + self.jacobian * JACOBIAN_COST

    def scalars(self) -> dict[str, float]:
        """Mean cost of the trials."""
        return {} if self.mean_cost is None else {"exploration/mean_cost": float(self.mean_cost.mean())}

    def theta(self, z: Tensor) -> Tensor:
        """The parameters `(..., runs, P)` at `z` `(..., runs, P)`."""
        return self.center + (self.L @ z.to(self.L).unsqueeze(-1)).squeeze(-1)

    def step(self, closure: Closure) -> Tensor:
        """Spend `n_rollouts` trials and leave the policies at what the method then recommends.

        Args:
            closure: the whole cost `(N, runs)` of the policies as they stand, differentiable where the method needs it.

        Returns:
            `(runs,)` the mean cost.
        """
        before, present = len(self._answers), self.policy.pack().detach().clone()
        try:
            for _ in range(0, self.n_rollouts, len(self._asked.z)):
                self._take(self._try(closure, self._asked.z))
            self._recommend(self._asked.answer)
        except BaseException:  # as if this step had not been
            self.policy.unpack(present)
            self.load_state_dict({"answers": [tuple(answer) for answer in self._answers[:before]]})
            raise
        cost = torch.cat([answer.cost for answer in self._answers[before:]])
        finite = cost.isfinite()
        self._failed = int((~finite).sum())
        self.mean_cost = torch.where(finite, cost, 0.0).sum(0) / finite.sum(0)
        return self.mean_cost

    def _recommend(self, z: Tensor) -> None:
        """Leave the policies at `z` `(runs, P)`; runs for which it is beyond the largest number stay."""
        theta = self.theta(z)
        finite = theta.isfinite().all(-1, keepdim=True)
        self.policy.unpack(torch.where(finite, theta, self.policy.pack().detach()))

    def _try(self, closure: Closure, z: Tensor) -> Answer:
        """Run the trials, each process its share of them where there are several (`torchds.optim.sharded`)."""
        present, theta = self.policy.pack().detach(), self.theta(z)
        shared = closure if isinstance(closure, Sharded) else None

        def tried(mine: slice) -> list[Tensor]:
            self.policy.unpack(theta[mine])
            with torch.set_grad_enabled(self.method.gradient), trying(Share(mine.start, mine.stop, len(z))):
                cost = closure()
            self._check_cost(cost, z[mine])
            return [cost.detach(), self._slopes(cost)] if self.method.gradient else [cost.detach()]

        try:
            found: Sequence[Any] = (
                tried(slice(0, len(z))) if shared is None else shared.together(len(z), tried, [theta])
            )
        finally:
            self.policy.unpack(present)
        cost, *slopes = found
        cost = cost.to("cpu", self.L.dtype)
        # The gradient in z is Lᵀ times the one in θ.
        gradient = (self.L.mT @ slopes[0].unsqueeze(-1)).squeeze(-1).cpu() if slopes else None
        return Answer(torch.where(cost.isfinite(), cost, torch.inf), gradient)

    def _slopes(self, cost: Tensor) -> Tensor:
        """The gradient `(n, runs, P)` of costs `(n, runs)` in θ; that of frozen parameters is zero."""
        named = dict(self.policy.named_parameters())
        free = {name: p for name, p in named.items() if p.requires_grad}
        slopes = torch.autograd.grad(cost.sum(), tuple(free.values()), materialize_grads=True)
        zero = {name: torch.zeros_like(p) for name, p in named.items()}
        return self.policy.join({**zero, **dict(zip(free, slopes, strict=True))})

    def _check_cost(self, cost: Tensor, z: Tensor) -> None:
        if not isinstance(cost, Tensor) or cost.shape != z.shape[:-1]:
            got = tuple(cost.shape) if isinstance(cost, Tensor) else shown(cost)
            raise InvalidArgumentError(f"the closure has to return costs {tuple(z.shape[:-1])} as a tensor, got {got}")

    def _begin(self) -> None:
        self._answers = []
        self._asking = self.method.begin(self.brief)
        self._asked = next(self._asking)

    def _take(self, answer: Answer) -> None:
        self._answers.append(answer)
        self._asked = self._asking.send(answer)

    def state_dict(self) -> dict[str, Any]:
        """All answers so far."""
        return {"answers": [tuple(answer) for answer in self._answers]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Play the answers to a new generator."""
        self._begin()
        for values in state["answers"]:
            self._take(Answer(*values))
