"""Exploration decays: picklable callables for `torch.optim.lr_scheduler.LambdaLR`.

Each maps the number of updates that are done, from 0, to a factor on `lr`, the standard deviation of the noise.

Stability: stable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from torchds.errors import InvalidArgumentError


def _check(n_updates: int, floor: float) -> None:
    if not n_updates >= 1:
        raise InvalidArgumentError(f"n_updates has to be at least 1, got {n_updates}")
    if not 0 < floor <= 1:
        raise InvalidArgumentError(f"floor has to be in (0, 1], got {floor}")


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
        _check(1, self.floor)

    def __call__(self, epoch: int) -> float:
        """The factor after `epoch` updates, for the update number epoch + 1."""
        return math.sqrt(max(1.0 / (epoch + 1), self.floor))


@dataclass
class LinearDecay:
    """lr factor max((N − n)/N, floor) at the n-th of N updates: what the authors' program does to the standard deviation.

    Args:
        n_updates: N.
        floor: the smallest factor, in (0, 1].

    Raises:
        InvalidArgumentError: a number or a floor out of its range.
    """

    n_updates: int
    floor: float = 0.1

    def __post_init__(self) -> None:
        _check(self.n_updates, self.floor)

    def __call__(self, epoch: int) -> float:
        """The factor after `epoch` updates, for the update number epoch + 1."""
        return max((self.n_updates - epoch - 1) / self.n_updates, self.floor)


@dataclass
class ExponentialDecay:
    """lr factor floor^(epoch/N): falls evenly on a logarithmic scale to `floor` after N updates, and stays there.

    Not the paper's: what the recommended learner uses (docs/recommended.md).

    Args:
        n_updates: N.
        floor: the last factor, in (0, 1].

    Raises:
        InvalidArgumentError: a number or a floor out of its range.
    """

    n_updates: int
    floor: float = 0.03

    def __post_init__(self) -> None:
        _check(self.n_updates, self.floor)

    def __call__(self, epoch: int) -> float:
        """The factor after `epoch` updates, for the update number epoch + 1."""
        return float(self.floor ** min(epoch / self.n_updates, 1.0))
