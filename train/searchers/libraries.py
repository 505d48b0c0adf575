"""Searchers of libraries that know one run at a time; the trials of all runs are still one batch."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchds.errors import MissingPackageError
from train.searchers.coordinates import Ask, Asking, Brief

BARRIER = 1e10  # cost of a trial that failed, for libraries that want finite numbers

Objective = Callable[[Tensor], tuple[Tensor, Tensor]]
"""z `(P,)` -> cost `()` and gradient `(P,)`, zero for methods without gradients."""
Minimise = Callable[[Objective, Tensor], None]
"""Minimises from a first z `(P,)`, for ever."""


def lockstep(brief: Brief, minimise: Minimise) -> Asking:
    """One minimiser a run, each in a thread that hands over a point and sleeps until all runs have been tried together.

    What is recommended is the cheapest point tried. The order of threads decides nothing.
    """
    best = torch.zeros(brief.runs, brief.P, dtype=torch.float64)
    lowest = torch.full((brief.runs,), torch.inf, dtype=torch.float64)
    workers = [_Worker(minimise, start) for start in best.clone()]
    try:
        while True:
            z = torch.stack([worker.request() for worker in workers])
            answer = yield Ask(z[None], best)
            cost, gradient = answer.cost[0], torch.zeros_like(z) if answer.gradient is None else answer.gradient[0]
            best, lowest = torch.where((cost < lowest).unsqueeze(-1), z, best), torch.minimum(cost, lowest)
            gradient = torch.where(cost.isfinite().unsqueeze(-1), gradient, 0.0).nan_to_num(0.0, 0.0, 0.0)
            for worker, reply in zip(workers, zip(cost.clamp(max=BARRIER), gradient, strict=True), strict=True):
                worker.replies.put(reply)
    finally:
        for worker in workers:
            worker.replies.put(None)


class _Stopped(Exception):
    """Nobody waits for this minimiser any more."""


class _Worker:
    """A minimiser in a thread of its own."""

    def __init__(self, minimise: Minimise, start: Tensor) -> None:
        self.requests: SimpleQueue[Tensor | Exception] = SimpleQueue()
        self.replies: SimpleQueue[tuple[Tensor, Tensor] | None] = SimpleQueue()
        threading.Thread(target=self._work, args=(minimise, start), daemon=True).start()

    def _work(self, minimise: Minimise, start: Tensor) -> None:
        try:
            minimise(self._objective, start)
        except _Stopped:
            pass
        except Exception as error:
            self.requests.put(error)

    def _objective(self, z: Tensor) -> tuple[Tensor, Tensor]:
        self.requests.put(z.detach().clone())
        reply = self.replies.get()
        if reply is None:
            raise _Stopped
        return reply

    def request(self) -> Tensor:
        """The point that the minimiser waits for; an error of its own is raised here."""
        request = self.requests.get()
        if isinstance(request, Exception):
            raise request
        return request


def lbfgs(brief: Brief) -> Asking:
    """L-BFGS with the strong Wolfe line search, whose trials count like all others."""

    def minimise(objective: Objective, start: Tensor) -> None:
        z = nn.Parameter(start)
        optim = torch.optim.LBFGS(
            [z],
            lr=brief.scale,
            max_iter=1_000_000,
            history_size=20,
            tolerance_grad=0.0,
            tolerance_change=0.0,
            line_search_fn="strong_wolfe",
        )

        def closure() -> Tensor:
            cost, z.grad = objective(z)
            return cost

        while True:
            optim.step(closure)

    return lockstep(brief, minimise)


def cobyqa(brief: Brief) -> Asking:
    """COBYQA, quadratic models in a trust region, of first radius one; begun again from where it ends.

    scipy's `minimize(method="COBYQA")` is the same code behind a lock, under which runs cannot take turns.
    """
    try:
        from cobyqa import minimize
    except ImportError as error:
        raise MissingPackageError("cobyqa", "baselines", "--optimizer cobyqa") from error

    def minimise(objective: Objective, start: Tensor) -> None:
        options = {"radius_init": brief.scale, "radius_final": 1e-8 * brief.scale, "maxfev": 1_000_000}
        z = start.numpy()
        while True:
            z = minimize(lambda z: float(objective(torch.from_numpy(z))[0]), z, options=options).x

    return lockstep(brief, minimise)


def cma(brief: Brief) -> Asking:
    """CMA-ES of first width one, with n_rollouts trials a generation; the recommendation is the mean."""
    try:
        from cma import CMAEvolutionStrategy
    except ImportError as error:
        raise MissingPackageError("cma", "baselines", "--optimizer cma") from error

    def begin(run: int) -> Any:
        draw = np.random.default_rng((brief.seed, run)).standard_normal
        options = {"popsize": brief.n_rollouts, "seed": np.nan, "randn": lambda *shape: draw(shape), "verbose": -9}
        return CMAEvolutionStrategy(np.zeros(brief.P), brief.scale, options)

    strategies = [begin(run) for run in range(brief.runs)]
    while True:
        points = np.stack([strategy.ask() for strategy in strategies], 1)  # (N, runs, P)
        means = torch.from_numpy(np.stack([strategy.mean for strategy in strategies]))
        answer = yield Ask(torch.from_numpy(points), means)
        costs = answer.cost.clamp(max=BARRIER).numpy()
        for run, strategy in enumerate(strategies):
            strategy.tell(list(points[:, run]), costs[:, run].tolist())
