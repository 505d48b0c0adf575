"""PI^BB that thinks before it tries, and after: what roll-outs will cost and have cost is judged by similar ones.

Stability: stable.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, Unpack, cast

import torch
from torch import Tensor, nn

from torchds.arrays import count
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.checkpoints import Entry
from torchds.optim.evaluation import Control
from torchds.optim.functional import cost_weights, failures
from torchds.optim.options import SharedOptions
from torchds.optim.pibb import PIBB
from torchds.optim.regression import RATIOS, Regression


class Recommendation(NamedTuple):
    """The policy that the roll-outs so far speak for.

    Attributes:
        parameters: `(*shape)` each, by name or in order as `ask` gives them.
        cost: `(*batch)` what it costs without noise, as far as is known.
        standard_error: `(*batch)` of that.
    """

    parameters: Any
    cost: Tensor
    standard_error: Tensor


NOISY = 0.05
"""The noise of costs that counts, relative to the largest standard deviation of what policies were found to differ by."""

SURE = (0.0039321, 0.10259, 0.35185, 0.71072, 1.1455)
"""What the sum of 1, 2, ... squares of unit normals exceeds 19 times out of 20: pairs of costs of one policy bound their noise
from above by it."""

WIDER = 0.7  # times the noise, relative to what policies differ by: how much more is explored where costs are noisy

IMAGINED = 1000  # policies that are averaged too where costs are noisy, weighed by what they are predicted to cost

ENOUGH = 50  # roll-outs that tell noise from what policies differ by, where no policy was tried twice
FEW = 80  # roll-outs that predict well where costs are exact

ELITENESS = 30.0  # of predicted costs: there are many, and their range is that of all of them

_KNOWN = Entry(
    "(*batch)",
    lambda shape, at: shape == at.shape[: len(shape)],
    of="search",
    beside="tried_cost",
    holds=lambda value: bool((value >= 0).all()),  # a bound may be infinite
)


class SurrogatePIBB(PIBB):
    r"""`PIBB` that draws many candidates for each update, tries the N that look cheapest, and does not believe every cost.

    What policies cost is predicted from the last roll-outs, by Gaussian process regression that finds out how noisy the costs
    are (`Regression`). Policies are as far from each other as `Exploration.measure` says: with `TrajectorySpace` as far as
    they move differently, so that the regression needs few roll-outs. Of the candidates those N are tried that are predicted to
    be cheapest. The first update has nothing to predict from and is plain, but that with elite="nominal" it tries the policy
    itself twice, and so do the next four if the two costs differ: by how much tells noise from costs that are rough, as they
    are near a wall.

    Where costs are noisy, by more than a twentieth of what policies have differed by (`NOISY`), two things change for the run:

    * Costs are not believed as measured. The update weighs the N roll-outs, and 1000 policies that are only imagined, by what
      they are predicted to cost, exp(−30 (Ŝ − min Ŝ) / (max Ŝ − min Ŝ)).
    * The exploration does not decay and is 1 + 0.7 √r times as wide, r the variance of the noise relative to that of what
      policies differ by: policies of small steps differ by less than the noise. Elsewhere a scheduler says how far it decays.

    Args:
        params: as for `PIBB`.
        exploration: as for `PIBB`; its `measure` is the distance.
        n_rollouts: N, roll-outs per step.
        lr: as for `PIBB`.
        n_candidates: how many the N are chosen from; N for no choice.
        memory: how many of the last roll-outs are remembered, of each run.
        **shared: the shared options below. An elite takes the place of the worst of the N chosen. It is "nominal" by default:
            with the policy's own cost among the known ones, the predictions do not lead away from it for long where they are
            wrong, as they are behind a wall that no roll-out has hit yet.

    Raises:
        InvalidArgumentError: fewer candidates than roll-outs, no memory, and what `PIBB` refuses.
        AllRolloutsFailedError: from `step`, if no roll-out has a finite cost; the parameters stay as they were.

    Example:
        >>> import torch, torchds
        >>> theta = torch.nn.Parameter(torch.zeros(2))
        >>> optim = torchds.optim.SurrogatePIBB([theta], torchds.exploration.Gaussian(0.3))
        >>> for _ in range(10):
        ...     cost = optim.step(lambda: (theta - 1.0).square().sum(-1))
        >>> bool(cost < 0.5)
        True
    """

    entries: ClassVar = {
        **PIBB.entries,
        "tried": Entry(
            "(M, *shape)",
            lambda shape, at: shape[1:] == at.shape and shape[0] > 0,
            beside="tried_cost",
            holds=lambda value: True,
        ),
        "tried_cost": Entry(
            "(M, *batch)",
            lambda shape, at: len(shape) > 0 and shape[1:] == at.shape[: len(shape) - 1],
            of="search",
            beside="tried",
            holds=lambda value: bool(value.isfinite().any()),
        ),
        "apart": Entry(
            "(R, *batch)",
            lambda shape, at: len(shape) > 0 and shape[0] <= len(SURE) and shape[1:] == at.shape[: len(shape) - 1],
            of="search",
            beside="tried_cost",
            holds=lambda value: True,
        ),
        **dict.fromkeys(("noise_ratio", "noise_bound", "cost_noise", "cost_signal"), _KNOWN),
    }
    shared_defaults: ClassVar[SharedOptions] = {**PIBB.shared_defaults, "temperature": "capped", "elite": "nominal"}

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None = None,
        n_rollouts: int = 10,
        lr: float = 1.0,
        *,
        n_candidates: int = 300,
        memory: int = 200,
        **shared: Unpack[SharedOptions],
    ) -> None:
        self.n_candidates, self.memory = n_candidates, memory
        self._beyond: list[list[Tensor]] = []  # candidates that are only imagined, per group and parameter
        self._belief: Tensor | None = None  # what they and the N roll-outs weigh
        self._predicted: Tensor | None = None  # costs (N, *batch) of the roll-outs that were chosen by them
        self._said: dict[str, float] = {}  # for `scalars`
        super().__init__(params, exploration, n_rollouts, lr, **shared)
        self._check_own()

    def _check_own(self) -> None:
        self.n_candidates, self.memory = count("n_candidates", self.n_candidates, 0), count("memory", self.memory, 0)
        if self.n_candidates < self.n_rollouts or self.memory < 1:
            raise InvalidArgumentError(
                f"n_candidates ≥ n_rollouts and memory ≥ 1 are needed, got {self.n_candidates} for {self.n_rollouts} and "
                f"{self.memory}"
            )

    def _check(self) -> None:
        super()._check()
        self._check_own()

    @property
    def _known(self) -> dict[str, Tensor]:
        """What is remembered of all parameters together."""
        known: dict[str, Tensor] = self.state[self._first]
        return known

    @property
    def noisy(self) -> Tensor | None:
        """`(*batch)` whether costs were found to be noisy; None before the first update."""
        known = self._known
        if "cost_noise" not in known:
            return None
        judged = known["noise_bound"].isfinite() | (len(known["tried_cost"]) >= ENOUGH)
        return (known["cost_noise"] > NOISY * known["cost_signal"]) & judged

    def _candidates(self, n: int) -> list[list[Tensor]]:
        """Noise `(n, *shape)` per group and parameter, which is wide and does not decay where costs are noisy."""
        found, wide = [], self.noisy
        for group, exploration, unit in zip(self.param_groups, self.explorations, self._normals(n), strict=True):
            lr = float(group["lr"])
            if wide is not None and wide.any() and lr > 0:
                wider = (1 + WIDER * self._known["noise_ratio"].sqrt()) * (group.get("initial_lr", lr) / lr)
                factor = torch.where(wide, wider, 1.0)
                unit = [z * factor.reshape(*wide.shape, *(1,) * (z.ndim - 1 - wide.ndim)) for z in unit]
            found.append(self._shape(group, exploration, unit))
        return found

    def _coordinates(self, noise: Sequence[Sequence[Tensor]]) -> Tensor:
        """`(M, *batch, F)` where each policy is, by its distance from the parameters `(M, *shape)` per group and parameter."""
        n = self._known["tried_cost"].ndim
        parts = [
            x.reshape(*x.shape[:n], -1)
            for group, exploration, epsilons in zip(self.param_groups, self.explorations, noise, strict=True)
            for x in exploration.measure(group["params"], epsilons)
        ]
        return torch.cat(parts, -1)

    def _regression(self, ratio: Tensor | None = None) -> Regression:
        """On all that is remembered; on the last `FEW`, which are nearer, where no run is noisy."""
        wide = self.noisy
        last = slice(None) if wide is not None and wide.any() else slice(-FEW, None)
        coordinates = self._coordinates([[e[last] for e in each] for each in self._tried_from_here()])
        return Regression(coordinates, self._known["tried_cost"][last], wide, ratio)

    def _tried_from_here(self) -> list[list[Tensor]]:
        return [[self.state[p]["tried"] - p for p in group["params"]] for group in self.param_groups]

    def _propose(self, normals: Sequence[Sequence[Tensor]] | None) -> list[list[Tensor]]:
        known = self._known
        if normals is not None or "tried_cost" not in known:
            first = super()._propose(normals)
            return first if normals is not None else self._doubled(first)
        drawn = self._candidates(self.n_candidates)
        regression = self._regression(known.get("noise_ratio"))
        predicted = regression.predict(self._coordinates(drawn))
        costs, best = predicted.topk(self.n_rollouts, dim=0, largest=False)
        self._predicted, best = costs.flip(0), best.flip(0)  # the cheapest last: an elite takes the first place
        self._said["surrogate/length"] = float(regression.length.mean())
        chosen = [
            [e.take_along_dim(best.reshape(*best.shape, *(1,) * (e.ndim - best.ndim)), 0) for e in noise]
            for noise in drawn
        ]
        return self._doubled(chosen)

    def _doubled(self, noise: list[list[Tensor]]) -> list[list[Tensor]]:
        """With the policy itself in the second place too, beside the elite, where that says more about the noise."""
        apart = self._known.get("apart")
        asks = apart is None or (len(apart) < len(SURE) and bool(self._known["noise_bound"].any()))
        if asks and self.elite == "nominal" and self.n_rollouts > 2:
            for epsilon in itertools.chain(*noise):
                epsilon[1] = 0.0
        return noise

    def _update(
        self, group: dict[str, Any], noise: list[Tensor], cost: Tensor, steps: Tensor, control: list[Control]
    ) -> Tensor:
        if group is self.param_groups[0]:
            self._judge(cost)
        wide, belief = self.noisy, self._belief
        if wide is None or belief is None:
            return super()._update(group, noise, cost, steps, control)
        measured = cost_weights(cost, float(group["eliteness"]), group["temperature"])
        weights = torch.where(wide, belief, torch.cat([measured, torch.zeros_like(belief[len(cost) :])]))
        index = next(i for i, other in enumerate(self.param_groups) if other is group)
        for p, tried, beyond in zip(group["params"], noise, self._beyond[index], strict=True):
            if p.requires_grad:
                epsilon = torch.cat([tried, beyond])
                each = weights.to(epsilon).reshape(*weights.shape, *(1,) * (epsilon.ndim - weights.ndim))
                p.add_((each * epsilon).sum(0))
        return weights[: len(cost)]

    def _judge(self, cost: Tensor) -> None:
        """Remember what was tried, find out how noisy costs `(N, *batch)` are, and weigh by predictions where they are."""
        tried = [[self.state[p]["noise"] for p in group["params"]] for group in self.param_groups]
        if (predicted := self._predicted) is not None:
            others = 0 if self.elite == "none" else 2  # in place of those that were chosen by it
            if len(predicted) > others:
                error = (predicted - cost)[others:]
                self._said["surrogate/predicted_cost"] = float(predicted[others:].mean())
                self._said["surrogate/error"] = float(error[~failures(error)].square().mean().sqrt())
            self._predicted = None
        for p in self.parameters:
            self._keep(p, "tried", p + self.state[p]["noise"])
        known = self._known
        self._keep(self._first, "tried_cost", cost)
        apart = known.get("apart", cost[:0])
        if len(apart) < len(SURE) and len(cost) > 1 and not any(bool(e[:2].any()) for e in itertools.chain(*tried)):
            apart = torch.cat([apart, cost[:1] - cost[1:2]])
        known["apart"], known["noise_bound"] = apart, _bound(apart)
        self._belief, bound = None, known["noise_bound"]
        if not bound.any():  # costs are exact, and there is nothing to find out
            known["noise_ratio"] = torch.full_like(bound, RATIOS[0])
            known["cost_noise"] = known["cost_signal"] = torch.zeros_like(bound)
            return
        regression = self._regression()
        known["cost_noise"] = torch.minimum(regression.noise, bound)
        known["cost_signal"] = torch.maximum(known.get("cost_signal", regression.signal), regression.signal)
        wide = cast(Tensor, self.noisy)
        known["noise_ratio"] = torch.where(wide, regression.ratio, RATIOS[0])
        if wide.any():
            self._beyond = self._candidates(IMAGINED)
            every = [
                [torch.cat(both) for both in zip(*parts, strict=True)]
                for parts in zip(tried, self._beyond, strict=True)
            ]
            predicted = regression.predict(self._coordinates(every))
            predicted[: len(cost)].masked_fill_(failures(cost), torch.inf)
            self._belief = cost_weights(predicted, ELITENESS)

    def _keep(self, p: nn.Parameter, name: str, values: Tensor) -> None:
        """Remember the last of all `values` `(N, ...)`."""
        state = self.state[p]
        state[name] = torch.cat([state.get(name, values[:0]), values])[-self.memory :]

    @torch.no_grad()
    def recommend(self, *, present: bool = True) -> Recommendation:
        """The policy to deploy: of the present one and those remembered, the one that is predicted to be cheapest.

        Args:
            present: whether the present one counts, which was not tried since the last update.

        Raises:
            InvalidArgumentError: nothing was tried yet.
        """
        known = self._known
        if "tried_cost" not in known:
            raise InvalidArgumentError("recommend() needs roll-outs to judge by; make a step first")
        from_here = [
            [torch.cat([e, torch.zeros_like(e[:1])]) for e in epsilons] for epsilons in self._tried_from_here()
        ]
        coordinates = self._coordinates(from_here)
        regression = Regression(coordinates[:-1], known["tried_cost"], self.noisy, known.get("noise_ratio"))
        predicted = regression.predict(coordinates)
        predicted[:-1].masked_fill_(failures(known["tried_cost"]), torch.inf)
        cost, best = predicted[: len(predicted) - (not present)].min(0, keepdim=True)
        error = regression.standard_error(coordinates).take_along_dim(best, 0)
        chosen = {
            p: p + e.take_along_dim(best.reshape(*best.shape, *(1,) * (e.ndim - best.ndim)), 0)[0]
            for group, epsilons in zip(self.param_groups, from_here, strict=True)
            for p, e in zip(group["params"], epsilons, strict=True)
        }
        return Recommendation(self._by_name(chosen), cost[0], error[0])

    def scalars(self) -> dict[str, float]:
        """Those of every search, and what the regression found.

        Returns:
            Its length; how noisy costs are, in their unit and relative to what policies differ by; the mean cost that it
            predicted for the last roll-outs, and by how much it was wrong (root mean square).
        """
        found, known = super().scalars() | self._said, self._known
        if "cost_noise" in known:
            found["surrogate/noise"] = float(known["cost_noise"].mean())
            found["surrogate/noise_ratio"] = float((known["cost_noise"] / known["cost_signal"]).nan_to_num(0.0).mean())
        return found


def _bound(apart: Tensor) -> Tensor:
    """What the noise `(*batch)` is below, 19 times out of 20, by pairs of costs `apart` `(R, *batch)`; infinite without any."""
    known = apart.isfinite()
    n = known.sum(0)
    sure = apart.new_tensor([0.0, *SURE])[n]  # infinite bounds where there is no pair
    return torch.where(n > 0, (apart.square().where(known, 0.0).sum(0) / (2 * sure)).sqrt(), torch.inf)
