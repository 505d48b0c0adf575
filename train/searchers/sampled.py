"""Policy search that draws new noise for every update: PI^BB and its kin, with the decay of their noise."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR

from tasks import Task
from tasks.loading import is_spec
from torchds import GMRPolicy
from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration import Exploration
from torchds.monitor import of_search
from torchds.optim import (
    PI2,
    PI2CMA,
    PIBB,
    ExponentialDecay,
    InverseIteration,
    LinearDecay,
    PolicySearch,
    SurrogatePIBB,
)
from train.options import RunOptions
from train.searchers.base import JACOBIAN_COST, Closure, Searcher
from train.searchers.explorations import along_motion
from train.searchers.own import make_own

SAMPLED: dict[str, type[PIBB] | type[PI2]] = {"pibb": PIBB, "pi2": PI2, "pi2cma": PI2CMA, "surrogate": SurrogatePIBB}
"""By the names of `--optimizer`."""


class SampledSearch(Searcher):
    """An optimizer of `torchds.optim` and the scheduler of its noise.

    Args:
        optim: the optimizer.
        decay: its scheduler.
        jacobian: whether its exploration looks at the motion again in every update.
    """

    optim: PolicySearch

    def __init__(self, optim: PolicySearch, decay: LambdaLR, *, jacobian: bool) -> None:
        self.optim, self.decay, self.jacobian = optim, decay, jacobian
        self.n_rollouts, self.costs_per_step = optim.n_rollouts, optim.costs_per_step
        self.lost = 0  # trials of the last step, where all of them failed

    @property
    def failed(self) -> int:
        """Trials of the last step without a finite cost, all runs together."""
        return self.lost if self.lost or self.optim.last is None else int(self.optim.last.failed.sum())

    def step(self, closure: Closure) -> Tensor:
        """One update of the optimizer and of the decay.

        Where all trials fail there is no update, and a search that remembers earlier ones goes back to the policy that they
        speak for.

        Raises:
            AllRolloutsFailedError: all trials failed, and there is nothing to go back to.
        """
        self.lost = 0
        try:
            cost = self.optim.step(closure)
        except AllRolloutsFailedError as error:
            cost = self._back(error)
            self.lost = self.n_rollouts * cost.numel()
        self.decay.step()
        return cost

    @torch.no_grad()
    def _back(self, error: AllRolloutsFailedError) -> Tensor:
        """Go back to a policy that was tried, and what it is thought to cost."""
        if not isinstance(self.optim, SurrogatePIBB):
            raise error
        try:
            known = self.optim.recommend(present=False)
        except InvalidArgumentError:  # nothing was tried before
            raise error from None
        values = known.parameters.values() if isinstance(known.parameters, dict) else known.parameters
        for p, value in zip(self.optim.parameters, values, strict=True):
            p.copy_(value)
        return known.cost

    def closure(self, task: Task, policy: GMRPolicy) -> Closure:
        """Trials without the control cost, which the optimizer adds by itself."""
        cost = task.step_costs if self.costs_per_step else task.cost
        return lambda: cost(task.rollout(policy))

    def forward_equivalents(self, updates: int) -> int:
        """The roll-outs, and the Jacobian in every update."""
        return updates * (self.n_rollouts + self.jacobian * JACOBIAN_COST)

    def scalars(self) -> dict[str, float]:
        """What the optimizer says about itself, and the costs that it saw."""
        return of_search(self.optim)

    def state_dict(self) -> dict[str, Any]:
        """Those of the optimizer and of the decay."""
        return {"optim": self.optim.state_dict(), "decay": self.decay.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue bit for bit."""
        self.optim.load_state_dict(state["optim"])
        self.decay.load_state_dict(state["decay"])

    def follow(self, before: Searcher) -> None:
        """Take over generator, decay and width; what was learned about the parameters before (a covariance) is gone."""
        if not isinstance(before, SampledSearch):
            raise InvalidArgumentError(f"a sampled search can follow another one only, not {type(before).__name__}")
        self.optim.generator = before.optim.generator
        self.decay.load_state_dict(copy.deepcopy(before.decay.state_dict()))
        self.optim.param_groups[0]["lr"] = before.optim.param_groups[0]["lr"]


def sampled_search(
    options: RunOptions, task: Task, policy: GMRPolicy, exploration: Exploration, *, n_rollouts: int, n_updates: int
) -> SampledSearch:
    """The optimizer that `--optimizer` names, over `n_updates` updates of `n_rollouts` roll-outs."""
    along, name = along_motion(options), options.optimizer
    # The time average of PI² keeps a policy stable only without its projection.
    form: dict[str, Any] = {"projected": False} if name == "pi2" and exploration.needs_convex_update else {}
    settings: dict[str, Any] = {
        "lr": options.scale,
        "exploration": exploration,
        "n_rollouts": n_rollouts,
        "temperature": options.temperature or ("capped" if along else task.search.temperature),
        "elite": options.elite or ("nominal" if name == "surrogate" else task.search.elite),
        "control_weight": task.search.control_weight,
        "generator": torch.Generator().manual_seed(options.seed),
    }
    optim: PolicySearch
    if is_spec(name):
        optim = make_own("optimizer", name, PolicySearch, policy.parameters(), **settings)  # type: ignore[type-abstract]
    else:
        optim = SAMPLED[name](policy.parameters(), **settings, **form)
    usual = "none" if name == "pi2cma" else "exponential" if along else task.search.decay
    return SampledSearch(optim, LambdaLR(optim, factor(options.decay or usual, n_updates)), jacobian=along)


def factor(decay: str, n_updates: int) -> Callable[[int], float]:
    """The factor on the width of the noise by update, of the decay that `--decay` names."""
    n = max(n_updates, 1)
    factors: dict[str, Callable[[int], float]] = {
        "inverse": InverseIteration(floor=0.1),
        "linear": LinearDecay(n),
        "exponential": ExponentialDecay(min(n, 50), floor=0.15),
        "none": ExponentialDecay(n, floor=1.0),
    }
    return factors[decay]
