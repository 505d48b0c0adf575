"""One writer: a lock on a folder that dies with its process.

Stability: experimental.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from torchds.errors import FileError
from torchds.files import reason

LOCK = ".lock"


@contextlib.contextmanager
def one_writer(folder: str | Path) -> Iterator[None]:
    """Hold the lock of a folder while the block runs; whoever comes second is refused and told who works there.

    The system releases the lock when the process ends, however it ends, so that none is ever left behind.

    Args:
        folder: that is there and can be written to.

    Raises:
        FileError: another process works there (since when, and which), or the folder cannot be written to.
    """
    path = Path(folder) / LOCK
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise FileError(f"{folder} cannot be locked: {reason(error)}") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(handle, 200, 0).decode(errors="replace").strip() or "another process"
            raise FileError(f"{folder} is in use by {holder}; wait until it ends, or use another folder") from None
        except OSError as error:
            raise FileError(f"{folder} cannot be locked: {reason(error)}") from error
        with contextlib.suppress(OSError):  # a full disk: the lock holds all the same
            os.ftruncate(handle, 0)
            since = time.strftime("%Y-%m-%d %H:%M:%S")
            os.pwrite(handle, f"process {os.getpid()} on {socket.gethostname()} since {since}\n".encode(), 0)
        yield
    finally:
        os.close(handle)
