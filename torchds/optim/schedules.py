"""Exploration decays: picklable callables for `torch.optim.lr_scheduler.LambdaLR`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torchds.errors import InvalidArgumentError


@dataclass
class InverseIteration:
    """lr factor sqrt(max(1/n, floor)) at the n-th update: line 11 of Algorithm 1.

    The paper's α scales the covariance of the noise, `lr` its standard deviation, hence the root.

    Args:
        floor: the smallest α, in (0, 1].

    Raises:
        InvalidArgumentError: a floor out of its range.
    """

    floor: float = 0.1

    def __post_init__(self) -> None:
        if not 0 < self.floor <= 1:
            raise InvalidArgumentError(f"floor has to be in (0, 1], got {self.floor}")

    def __call__(self, epoch: int) -> float:
        """The factor after `epoch` updates, for the update number epoch + 1."""
        return math.sqrt(max(1.0 / (epoch + 1), self.floor))
