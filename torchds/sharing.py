"""Which of the N roll-outs this process tries, and random numbers that are those of one process.

Where roll-outs are shared out (`torchds.optim.sharded`), chance must not depend on by how many: every process draws for all of
them and takes what belongs to its own.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple

from torch import Tensor


class Share(NamedTuple):
    """The roll-outs from `first` up to `last` of N."""

    first: int
    last: int
    N: int


_share: ContextVar[Share | None] = ContextVar("torchds_share", default=None)


@contextmanager
def trying(share: Share | None) -> Iterator[None]:
    """Say that the closure which runs inside the block tries this share; None where it tries one policy at a time."""
    token = _share.set(share)
    try:
        yield
    finally:
        _share.reset(token)


def whole(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape `(N, ...)` of what all processes try together, from the one `(n, ...)` of what this process tries.

    Args:
        shape: with this process's n roll-outs in front; any other one is of something that is not shared, and stays.
    """
    share = _share.get()
    return shape if share is None or shape[:1] != (share.last - share.first,) else (share.N, *shape[1:])


def drawn(shape: tuple[int, ...], draw: Callable[[tuple[int, ...]], Tensor]) -> Tensor:
    """What belongs to this process's roll-outs of what is drawn for all of them.

    Args:
        shape: `(n, ...)` of the roll-outs of this process.
        draw: makes a tensor of the shape that it is given, the same in all processes; called once.

    Returns:
        `shape`.

    Example:
        >>> import torch
        >>> generator = torch.Generator().manual_seed(0)
        >>> drawn((3, 2), lambda shape: torch.randn(shape, generator=generator)).shape
        torch.Size([3, 2])
    """
    values, share = draw(whole(shape)), _share.get()
    return values if share is None or values.shape == shape else values[share.first : share.last]
