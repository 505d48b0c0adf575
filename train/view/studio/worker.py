"""A process beside the page, so that the page never waits; it ends with the pipe, so that none is ever left behind."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import torch

from torchds.errors import TorchdsError

PRELOADED = [
    "__main__",
    "train.view.studio.imitating",
    "train.view.studio.learning",
    "torchds.kernels.cpu",
]  # by the process that the others begin as


class Failed(NamedTuple):
    """What could not be done, as a sentence."""

    message: str


class Pipe:
    """Messages of any kind, tensors copied.

    Args:
        connection: one end of a pipe.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def send(self, message: Any) -> None:
        """Raises OSError where nobody is there to hear it."""
        self.connection.send_bytes(pickle.dumps(message))

    def next(self) -> Any:
        """The next message, which is waited for; raises EOFError where none will come."""
        return pickle.loads(self.connection.recv_bytes())

    def waits(self, seconds: float = 0.0) -> bool:
        """Whether a message, or the end, comes within this time."""
        return self.connection.poll(seconds)


class Worker:
    """A process that answers messages.

    Args:
        work: what it does: `work(pipe, *arguments)`, until the pipe ends.
        *arguments: that can be pickled.
    """

    def __init__(self, work: Callable[..., None], *arguments: Any) -> None:
        context = multiprocessing.get_context(
            "forkserver"
        )  # threads of the page may hold locks, which a fork would inherit
        context.set_forkserver_preload(PRELOADED)
        here, there = context.Pipe()
        self.pipe = Pipe(here)
        self.process = context.Process(target=_main, args=(there, work, arguments), daemon=True)
        self._beginning = threading.Thread(target=self._begin, args=(there,), daemon=True)
        self._beginning.start()  # the first process takes seconds to import everything

    def _begin(self, there: Connection) -> None:
        with there, contextlib.suppress(EOFError, OSError):  # the page has ended, or there is no process to be had
            self.process.start()

    def tell(self, message: Any) -> None:
        """Send a message; a process that has ended does not hear it, see `answers`."""
        with contextlib.suppress(OSError):
            self.pipe.send(message)

    def answers(self) -> list[Any] | None:
        """All that have come by now; None once the process has ended and all was heard."""
        found: list[Any] = []
        try:
            while self.pipe.waits():
                found.append(self.pipe.next())
        except (EOFError, OSError):
            return found or None
        return found

    def leave(self) -> None:
        """Let it go without waiting until it has ended."""
        threading.Thread(target=self.end, daemon=True).start()

    def end(self) -> None:
        """Let it go; whatever it is doing, it ends soon."""
        self._beginning.join()
        self.pipe.connection.close()
        if self.process.pid is None:  # it never began
            return
        self.process.join(5)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def _main(connection: Connection, work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which ends the pipe
    torch.set_num_threads(1)
    with contextlib.suppress(EOFError, OSError):
        work(Pipe(connection), *arguments)


def said(call: Callable[[], Any]) -> Any:
    """What comes back, or why nothing does, as a sentence."""
    try:
        return call()
    except TorchdsError as error:
        return Failed(" ".join(str(error).split()))
    except (EOFError, OSError):
        raise
    except Exception as error:  # the page goes on, whatever it is
        return Failed(f"this cannot be computed: {type(error).__name__}: {error}")
