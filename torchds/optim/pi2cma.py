"""PI^BB that adapts the covariance of its noise: PI2-CMA.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar, Unpack

import torch
from torch import Tensor

from torchds.arrays import number, transformed
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.checkpoints import NOISE, Entry, Place, Shape, finite
from torchds.optim.evaluation import Control
from torchds.optim.functional import informative
from torchds.optim.options import SharedOptions
from torchds.optim.pibb import PIBB


def _square(shape: Shape, at: Place) -> bool:
    runs = shape[:-2]
    size = sum(p[(0,) * len(runs)].numel() for p in at.group["params"]) if runs == at.shape[: len(runs)] else -1
    return len(shape) >= 2 and shape[-2:] == (size, size)


def _positive(value: Tensor) -> bool:
    return finite(value) and bool((torch.linalg.cholesky_ex(value).info == 0).all())


COVARIANCE = Entry("(*batch, P, P), positive definite", _square, of="group", holds=_positive)


class PI2CMA(PIBB):
    r"""`PIBB` whose noise takes the shape of what was worth it (F. Stulp, O. Sigaud, ICML 2012), the paper's future work.

    The weights that move the parameters also average the noise's outer products. They are those of the normals that the
    exploration shapes, not of the parameters, so that any exploration gives the first covariance and the unit: with ε = L z
    and z ~ N(0, Σ), Σ = I at first and of its own for every run,

    .. math:: Σ ← (1 - c) Σ + c \sum_r P_r z_r z_r^T,

    with eigenvalues that stay above a bound. The weights prefer small noise near an optimum, so Σ shrinks by itself and
    needs no decay of `lr`; where costs fall steadily in one direction, it grows there.

    Args:
        params: as for `PIBB`. The noise of a group has one covariance for all of its parameters.
        exploration: as for `PIBB`.
        n_rollouts: as for `PIBB`.
        lr: as for `PIBB`.
        rate: c in [0, 1]; 1 forgets what was before, 0 is `PIBB`.
        lower_bound: of the eigenvalues of Σ, in (0, 1].
        **shared: the shared options below; elite="best" is not among them, since it says nothing about the normals behind it.

    Raises:
        InvalidArgumentError: a rate, a bound or an elite that is not allowed, and what `PIBB` refuses.
        AllRolloutsFailedError: from `step`, if no roll-out has a finite cost; the parameters stay as they were.

    Example:
        >>> import torch, torchds
        >>> theta = torch.nn.Parameter(torch.zeros(2))
        >>> optim = torchds.optim.PI2CMA([theta], exploration=torchds.exploration.Gaussian(0.3))
        >>> for _ in range(50):
        ...     cost = optim.step(lambda: (theta - 1.0).square().sum(-1))
        >>> bool(cost < 0.01)
        True
    """

    entries: ClassVar = {
        **PIBB.entries,
        "noise": NOISE._replace(beside="normals"),
        "normals": NOISE._replace(beside="noise"),
        "covariance": COVARIANCE,
    }

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None = None,
        n_rollouts: int = 10,
        lr: float = 1.0,
        *,
        rate: float = 0.1,
        lower_bound: float = 1e-4,
        **shared: Unpack[SharedOptions],
    ) -> None:
        self.rate, self.lower_bound = rate, lower_bound
        self._check_own(shared.get("elite"))
        super().__init__(params, exploration, n_rollouts, lr, **shared)

    def _check_own(self, elite: Any) -> None:
        if elite == "best":
            raise InvalidArgumentError("elite of PI2CMA has to be 'none' or 'nominal', got 'best'; use PIBB with it")
        self.rate = number("rate", self.rate, "in [0, 1]", lambda c: 0 <= c <= 1)
        self.lower_bound = number("lower_bound", self.lower_bound, "in (0, 1]", lambda bound: 0 < bound <= 1)

    def _check(self) -> None:
        super()._check()
        self._check_own(self.elite)

    def _shape(self, group: dict[str, Any], exploration: Exploration, normals: list[Tensor]) -> list[Tensor]:
        known = self.state[group["params"][0]]
        if "covariance" in known:
            root = torch.linalg.cholesky(known["covariance"])
            drawn = _stack(normals, root.ndim - 1)
            normals = _cut(transformed(root, drawn), normals)
        normals = [z if p.requires_grad else torch.zeros_like(z) for p, z in zip(group["params"], normals, strict=True)]
        if self.elite == "nominal":
            normals = [torch.cat([torch.zeros_like(z[:1]), z[1:]]) for z in normals]
        for p, z in zip(group["params"], normals, strict=True):
            self.state[p]["normals"] = z
        return super()._shape(group, exploration, normals)

    def _update(
        self, group: dict[str, Any], noise: list[Tensor], cost: Tensor, steps: Tensor, control: list[Control]
    ) -> Tensor:
        weights = super()._update(group, noise, cost, steps, control)
        state = self.state[group["params"][0]]
        z = _stack([self.state[p]["normals"] for p in group["params"]], cost.ndim)  # (N, *batch, P)
        moment = torch.einsum("n...,n...i,n...j->...ij", weights.to(z), z, z)
        before = state.get("covariance", torch.eye(z.shape[-1], dtype=z.dtype, device=z.device).expand_as(moment))
        if not all(p.requires_grad for p in group["params"]):  # what is frozen keeps its own covariance
            whole = [
                torch.full_like(z[:1], float(not p.requires_grad)) for p, z in zip(group["params"], noise, strict=True)
            ]
            frozen = _stack(whole, cost.ndim)[0]
            moment = moment + before * frozen.unsqueeze(-1) * frozen.unsqueeze(-2)
        # A run that has no weights since all of its roll-outs failed, or equal ones, keeps its covariance.
        rate = self.rate * (weights.sum(0) * informative(cost)).to(z)
        learned = before + rate[..., None, None] * (moment - before)
        values, vectors = torch.linalg.eigh(learned)
        state["covariance"] = (vectors * values.clamp_min(self.lower_bound).unsqueeze(-2)) @ vectors.mT
        return weights

    def _forget(self) -> None:
        super()._forget()
        for entries in self.state.values():
            entries.pop("normals", None)


def _stack(parts: list[Tensor], lead: int) -> Tensor:
    """All parameters' parts `(N, *batch, *own)` as one vector `(N, *batch, P)`; `lead` counts the axes in front."""
    return torch.cat([part.reshape(*part.shape[:lead], -1) for part in parts], -1)


def _cut(stacked: Tensor, like: list[Tensor]) -> list[Tensor]:
    """What `_stack` made, in the shapes of `like`."""
    lead = stacked.ndim - 1
    cuts = torch.split(stacked, [z.shape[lead:].numel() for z in like], -1)
    return [cut.reshape(z.shape) for cut, z in zip(cuts, like, strict=True)]
