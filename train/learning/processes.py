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
from torchds.optim import sharded
from train.learning.learner import Learner
from train.searchers.base import Closure

JOINING = 600.0  # s that processes may at least be apart when they begin: in imports, fits, and the first trial


class Processes:
    """Those of one run; without torchrun there is one, which leads."""

    rank, size = 0, 1

    def tell(self, said: Any) -> None:
        """Tell all others, who wait for it, what is to be done; the first time counts. They have made ready when it returns."""

    def share(self, closure: Closure, learner: Learner) -> Closure:
        """What a learner calls in place of `closure`."""
        return closure


class Several(Processes):
    """Several processes, joined by `torch.distributed`.

    Args:
        patience: how long one waits for the others in an update [s].
    """

    def __init__(self, patience: float) -> None:
        self.rank, self.size = dist.get_rank(), dist.get_world_size()
        self.group = dist.new_group(timeout=timedelta(seconds=patience))
        self._told = False

    def tell(self, said: Any) -> None:
        """See `Processes`."""
        if not self._told:
            self._told = True
            self._broadcast(said)
            if said is not None:
                self.ready()

    def hear(self) -> Any:
        """What the first process tells; None where it has ended, or there is nothing to do.

        Raises:
            ProcessLostError: it ended without a word.
        """
        return self._broadcast(None)

    def ready(self) -> None:
        """Wait until all processes are ready for the first update."""
        with self._lost():
            dist.barrier()

    def share(self, closure: Closure, learner: Learner) -> Closure:
        """The closure of this process's share of the roll-outs."""
        return sharded(closure, self.group)

    def _broadcast(self, said: Any) -> Any:
        content = [said]
        with self._lost():
            dist.broadcast_object_list(content)
        return content[0]

    @contextmanager
    def _lost(self) -> Iterator[None]:
        try:
            yield
        except RuntimeError as error:
            raise ProcessLostError(
                f"process {self.rank} of {self.size} has lost another one before the first update; begin them all again"
            ) from error


def restarts() -> int:
    """How many times torchrun will restart all processes if one of them fails."""
    return int(os.environ.get("TORCHELASTIC_MAX_RESTARTS", 0))


@contextmanager
def joined(patience: float) -> Iterator[Processes]:
    """The processes that torchrun started, joined while the block runs; those that are joined already stay so.

    Args:
        patience: how long they wait for each other in an update before they give up [s].
    """
    if dist.is_available() and dist.is_initialized():
        yield Several(patience)
        return
    if int(os.environ.get("WORLD_SIZE", 1)) == 1:
        yield Processes()
        return
    dist.init_process_group("gloo", timeout=timedelta(seconds=max(patience, JOINING)))
    try:
        yield Several(patience)
    finally:
        dist.destroy_process_group()
