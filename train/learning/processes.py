"""One run by several processes that torchrun started: the first leads and writes, all try their share of the roll-outs.

All processes hold the same learner, bit for bit, since each makes every update itself (`torchds.optim.sharded`). So the first
one needs to tell the others only once what is run and where it stands; what it writes says all that a restart needs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import torch.distributed as dist

from torchds.errors import ProcessLostError


class Processes:
    """Those of one run; without torchrun there is one, which leads."""

    rank, size = 0, 1

    def tell(self, said: Any) -> None:
        """Tell all others, who wait for it, what is to be done; the first time counts."""


class Several(Processes):
    """Several processes, joined by `torch.distributed`."""

    def __init__(self) -> None:
        self.rank, self.size = dist.get_rank(), dist.get_world_size()
        self._told = False

    def tell(self, said: Any) -> None:
        """See `Processes`."""
        if not self._told:
            self._told = True
            self._broadcast(said)

    def hear(self) -> Any:
        """What the first process tells; None where it has ended, or there is nothing to do.

        Raises:
            ProcessLostError: it ended without a word.
        """
        return self._broadcast(None)

    def _broadcast(self, said: Any) -> Any:
        content = [said]
        try:
            dist.broadcast_object_list(content)
        except RuntimeError as error:
            raise ProcessLostError(
                f"process {self.rank} of {self.size} has lost another one before the first update; begin them all again"
            ) from error
        return content[0]


def restarts() -> int:
    """How many times torchrun will restart all processes if one of them fails."""
    return int(os.environ.get("TORCHELASTIC_MAX_RESTARTS", 0))


@contextmanager
def joined(patience: float) -> Iterator[Processes]:
    """The processes that torchrun started, joined while the block runs; those that are joined already stay so.

    Args:
        patience: how long they wait for each other before they give up [s].
    """
    if dist.is_available() and dist.is_initialized():
        yield Several()
        return
    if int(os.environ.get("WORLD_SIZE", 1)) == 1:
        yield Processes()
        return
    dist.init_process_group("gloo", timeout=timedelta(seconds=patience))
    try:
        yield Several()
    finally:
        dist.destroy_process_group()
