"""PI^BB that thinks before it tries: noise is preselected by what similar roll-outs cost.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Unpack

import torch
from torch import Tensor

from torchds.arrays import count
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.checkpoints import Entry
from torchds.optim.evaluation import Control
from torchds.optim.functional import predict_costs
from torchds.optim.options import SharedOptions
from torchds.optim.pibb import PIBB


class SurrogatePIBB(PIBB):
    r"""`PIBB` that draws many candidates for each update and tries the N of them that look cheapest.

    What a candidate will cost is predicted from the last roll-outs, by Gaussian process regression on the distance between
    policies (`functional.predict_costs`). The distance is that of the exploration, `Exploration.measure`: with
    `TrajectorySpace` it says how differently two policies move, so that the regression needs few roll-outs. The update is the
    one of `PIBB`, from the costs that the N roll-outs really had. The first update has nothing to predict from and is plain.

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
        memory: int = 80,
        **shared: Unpack[SharedOptions],
    ) -> None:
        self.n_candidates, self.memory = n_candidates, memory
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

    def _propose(self, normals: Sequence[Sequence[Tensor]] | None) -> list[list[Tensor]]:
        known = self.state[self.param_groups[0]["params"][0]]
        if normals is not None or "tried_cost" not in known:
            return super()._propose(normals)
        costs = known["tried_cost"]  # (M, *batch)
        drawn, coordinates = [], []
        for group, exploration, unit in zip(
            self.param_groups, self.explorations, self._normals(self.n_candidates), strict=True
        ):
            noise, params = self._shape(group, exploration, unit), group["params"]
            drawn.append(noise)
            both = [torch.cat([self.state[p]["tried"] - p, e]) for p, e in zip(params, noise, strict=True)]
            coordinates += [x.reshape(*x.shape[: costs.ndim], -1) for x in exploration.measure(params, both)]
        tried, untried = torch.cat(coordinates, -1).tensor_split([len(costs)])
        best = predict_costs(tried, costs, untried).topk(self.n_rollouts, dim=0, largest=False).indices
        best = best.flip(0)  # (N, *batch), the cheapest last: an elite takes the first place
        return [
            [e.take_along_dim(best.reshape(*best.shape, *(1,) * (e.ndim - best.ndim)), 0) for e in noise]
            for noise in drawn
        ]

    def _update(
        self, group: dict[str, Any], noise: list[Tensor], cost: Tensor, steps: Tensor, control: list[Control]
    ) -> Tensor:
        for p, epsilon in zip(group["params"], noise, strict=True):
            self._keep(p, "tried", p + epsilon)
        if group is self.param_groups[0]:
            self._keep(group["params"][0], "tried_cost", cost)
        return super()._update(group, noise, cost, steps, control)

    def _keep(self, p: Tensor, name: str, values: Tensor) -> None:
        """Remember the last of all `values` `(N, ...)`."""
        state = self.state[p]
        state[name] = torch.cat([state.get(name, values[:0]), values])[-self.memory :]
