"""`python -m train studio`: a local page on which motions are drawn, imitated, improved by trial, and pushed."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path

from torchds.errors import InvalidArgumentError
from torchds.locks import one_writer
from train.folder import make_folder

HOST = "127.0.0.1"


@dataclass
class Studio:
    """Draw a motion in the browser, watch it become a system, and let it learn (extra "studio")."""

    port: int = 0
    """Of the page; 0 for one that is free."""
    folder: Path = Path("logs/studio")
    """Where the state of the page is kept; its learning runs are beside this folder."""
    show: bool = True
    """Whether a browser is opened."""

    def main(self) -> None:
        """Serve the page until Ctrl-C.

        Raises:
            MissingPackageError: without the package nicegui.
            InvalidArgumentError: a port that is not free.
            FileError: another studio works in this folder, or it cannot be written to.
        """
        from train.view.studio import layout
        from train.view.studio.state import Studio as State

        port = free(self.port)
        make_folder(self.folder)
        with one_writer(self.folder):
            state = State(self.folder)
            try:
                layout.serve(state, HOST, port, show=self.show)
            except KeyboardInterrupt:
                print("ended; the same command goes on where it was")
            finally:
                state.end()


def free(port: int) -> int:
    """This port, or for 0 one that is free.

    Raises:
        InvalidArgumentError: it is not free.
    """
    with socket.socket() as found:
        found.setsockopt(
            socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
        )  # a page that was just ended still holds its port a little
        try:
            found.bind((HOST, port))
        except (OverflowError, OSError):
            raise InvalidArgumentError(f"--port has to be free, got {port}; give 0 for one that is") from None
        return int(found.getsockname()[1])
