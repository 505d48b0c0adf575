"""The noise of an update: unit normals, shaped by the explorations, and kept until the costs are there.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from torchds.arrays import like
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.checkpoints import Resumable, finite
from torchds.optim.elite import put_first
from torchds.optim.options import Elite


class Drawing(Resumable):
    """The part of a search that draws noise; frozen parameters get none."""

    elite: Elite

    @property
    def _first(self) -> nn.Parameter:
        return self.parameters[0]

    @property
    def _asked(self) -> bool:
        """Whether noise is waiting for its costs."""
        return all("noise" in self.state.get(p, {}) for p in self.parameters)

    def _forget(self) -> None:
        for entries in self.state.values():
            entries.pop("noise", None)

    def _draw(self, normals: Sequence[Sequence[Tensor]] | None) -> None:
        proposed = self._propose(normals)
        noise = {
            p: epsilon
            for group, epsilons in zip(self.param_groups, proposed, strict=True)
            for p, epsilon in zip(group["params"], epsilons, strict=True)
        }
        put_first(self.elite, noise, self.state)
        for p, epsilon in noise.items():
            if not p.requires_grad:
                epsilon.zero_()
            if not finite(epsilon):
                raise InvalidArgumentError(
                    f"the noise of a parameter of shape {tuple(p.shape)} is not finite; explore less (lr), and look at its "
                    "exploration"
                )
            self.state[p]["noise"] = epsilon

    def _propose(self, normals: Sequence[Sequence[Tensor]] | None) -> list[list[Tensor]]:
        """The noise `(N, *shape)` that the next update tries, per group and parameter.

        Args:
            normals: unit normals to use in place of drawn ones, per group and parameter `(N, *shape)`.
        """
        given = self._normals(self.n_rollouts) if normals is None else list(normals)
        noise = []
        for i, group in enumerate(self.param_groups):
            shapes = [(self.n_rollouts, *p.shape) for p in group["params"]]
            unit = [like("normals", z, self._first) for z in given[i]] if i < len(given) else []
            if [tuple(z.shape) for z in unit] != shapes:
                raise InvalidArgumentError(
                    f"group {i} needs normals of shapes {shapes}, got {[tuple(z.shape) for z in unit]}"
                )
            unit = [z.to(p) for z, p in zip(unit, group["params"], strict=True)]
            noise.append(self._shape(group, self.explorations[i], unit))
        return noise

    def _normals(self, n: int) -> list[list[Tensor]]:
        """Unit normals `(n, *shape)` per group and parameter, drawn on the CPU and moved: the same on every device."""
        return [
            [torch.randn((n, *p.shape), generator=self.generator, dtype=p.dtype).to(p.device) for p in group["params"]]
            for group in self.param_groups
        ]

    def _shape(self, group: dict[str, Any], exploration: Exploration, normals: list[Tensor]) -> list[Tensor]:
        """The noise `(n, *shape)` of a group's parameters that `normals` of the same shapes become."""
        scaled = [float(group["lr"]) * z for z in normals]
        noise = list(exploration(group["params"], scaled))
        if [getattr(e, "shape", None) for e in noise] != [z.shape for z in scaled]:
            raise InvalidArgumentError(
                f"{type(exploration).__name__} has to give noise of shapes {[tuple(z.shape) for z in scaled]}, got "
                f"{[getattr(e, 'shape', type(e).__name__) for e in noise]}"
            )
        return [
            e.to(z) if p.requires_grad else torch.zeros_like(z)
            for p, z, e in zip(group["params"], scaled, noise, strict=True)
        ]
