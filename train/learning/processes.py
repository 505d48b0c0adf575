"""One run by several processes that torchrun started: the first leads and writes, all try their share of the roll-outs.

All processes hold the same learner, bit for bit, since each makes every update itself (`torchds.optim.sharded`). So the first
one needs to tell the others only once what is run and where it stands; what it writes says all that a restart needs.
"""

from __future__ import annotations

import os
import time
import uuid
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


def agreed(store: dist.Store, rank: int, size: int, seconds: float) -> str:
    """A name that these processes have agreed on, and none before them.

    torchrun keeps one store over restarts, in which the addresses of dead processes still stand. So each process says who it
    is, by a number of its own, the first one says whom it has found, and only what all of them confirm counts.

    Raises:
        ProcessLostError: not all have come in time.
    """
    me, end = uuid.uuid4().hex, time.monotonic() + seconds

    def read(name: str) -> str:
        return store.get(f"torchds {name}").decode() if store.check([f"torchds {name}"]) else ""

    def write(name: str, value: str) -> None:
        store.set(f"torchds {name}", value)

    write(f"hello {rank}", me)
    while time.monotonic() < end:
        if rank == 0:
            found = " ".join(read(f"hello {other}") for other in range(size))
            write("found", found)
            if all(read(f"confirmed {other}") == found for other in range(1, size)):
                write("agreed", found)
        found = read("found")
        if me in found.split() and rank:
            write(f"confirmed {rank}", found)
        if me in (name := read("agreed")).split():
            return name
        time.sleep(0.02)
    raise ProcessLostError(
        f"process {rank} of {size} has not met all others within {seconds:g} s; begin them all again"
    )


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
    seconds = max(patience, JOINING)
    store, rank, size = next(iter(dist.rendezvous("env://", timeout=timedelta(seconds=seconds))))
    mine = dist.PrefixStore(agreed(store, rank, size, seconds), store)
    dist.init_process_group("gloo", store=mine, rank=rank, world_size=size, timeout=timedelta(seconds=seconds))
    try:
        yield Several(patience)
    finally:
        dist.destroy_process_group()
