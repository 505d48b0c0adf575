"""Who works on what: claims that any number of processes on any machines make on files of one folder.

The n-th claim of a job is a file NAME.n that nobody else can make (O_EXCL). While a worker lives, a thread of it touches the
file; another one that has seen the file unchanged for longer than `patience`, by its own clock, makes NAME.n+1, and the job is
its own. Nothing is ever moved or removed, so that no two workers can take each other's claim by mistake, and the clocks of
machines need not agree. A worker that was only asleep finds the next claim before it writes anything.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from torchds.errors import FileError
from torchds.files import make_folder, reason

RELEASED = 0  # time of a claim that its worker has given back


class Superseded(Exception):
    """Another worker has taken the job, since this one was silent for too long."""


class Seen(NamedTuple):
    """The newest claim of a job.

    Attributes:
        number: which claim it is, from 1; 0 where there is none.
        beat: when it was touched last [ns], by the clock of the file system.
        died: how many claims before and with it were never given back.
    """

    number: int = 0
    beat: int = RELEASED
    died: int = 0


class Claims:
    """The claims of a folder.

    Args:
        folder: that all workers see; it is made where it is missing.
        beat: seconds between two touches.
        patience: seconds without one after which a worker counts as dead; several times `beat`.
    """

    def __init__(self, folder: Path, beat: float, patience: float) -> None:
        make_folder(folder)
        self.folder, self.beat, self.patience = folder, beat, patience
        self._known: dict[
            str, tuple[int, int, float]
        ] = {}  # number, beat, and since when they have been seen like that
        self._looked = 0.0

    def newest(self) -> dict[str, Seen]:
        """The newest claim of each job that has one."""
        found: dict[str, Seen] = {}
        self._looked = time.monotonic()
        with os.scandir(self.folder) as entries:
            for entry in entries:
                name, _, number = entry.name.rpartition(".")
                if name and number.isdigit():
                    seen, beat = found.get(name, Seen()), entry.stat().st_mtime_ns
                    last = max(Seen(int(number), beat), seen._replace(died=0))
                    found[name] = last._replace(died=seen.died + (beat != RELEASED))
        return found

    def alone(self, name: str, seen: Seen) -> bool:
        """Whether nobody works on a job: it was never claimed, was given back, or its worker is silent for too long.

        Args:
            name: of the job.
            seen: its newest claim at the last look at all of them.
        """
        if seen.beat == RELEASED:
            return True
        known = self._known.get(name)
        if known is None or known[:2] != seen[:2]:
            self._known[name] = (*seen[:2], self._looked)
            return False
        return self._looked - known[2] > self.patience

    @contextlib.contextmanager
    def take(self, name: str, seen: Seen) -> Iterator[Claim | None]:
        """Claim a job on which nobody works, while the block runs; None where another worker was faster.

        A block that ends, however it ends, gives the job back; a process that is killed does not.

        Raises:
            FileError: the folder cannot be written to.
        """
        path = self.path(name, seen.number + 1)
        try:
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            yield None
            return
        except OSError as error:
            raise FileError(f"{path} cannot be made: {reason(error)}") from error
        with os.fdopen(handle, "w") as file:
            file.write(f"process {os.getpid()} on {socket.gethostname()} since {time.strftime('%Y-%m-%d %H:%M:%S')}\n")
        claim = Claim(path, self.path(name, seen.number + 2))
        stop = threading.Event()
        thread = threading.Thread(target=claim.touch, args=(stop, self.beat), daemon=True)
        thread.start()
        try:
            yield claim
        finally:
            stop.set()
            thread.join()
            give_back(path)

    def path(self, name: str, number: int) -> Path:
        """The file of a claim."""
        return self.folder / f"{name}.{number}"

    def forgive(self, name: str) -> None:
        """Count a job as never claimed by anybody who died."""
        for path in self.folder.glob(f"{name}.*"):
            give_back(path)


class Claim:
    """A job that is this worker's own.

    Args:
        path: its file.
        later: the file that another worker makes where it takes the job.
    """

    def __init__(self, path: Path, later: Path) -> None:
        self.path, self.later = path, later

    def check(self) -> None:
        """Make sure that the job is still one's own.

        Raises:
            Superseded: it is not.
        """
        if self.later.exists():
            raise Superseded(str(self.later))

    def touch(self, stop: threading.Event, beat: float) -> None:
        """Show a sign of life every few seconds, until told to stop."""
        while not stop.wait(beat):
            with contextlib.suppress(OSError):
                os.utime(self.path)


def give_back(path: Path) -> None:
    """Mark a claim as released."""
    with contextlib.suppress(OSError):
        os.utime(path, ns=(RELEASED, RELEASED))
