"""What all parts of a page share: the state, the controls that show it, and a way to do things that may not work."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torchds.errors import TorchdsError
from train.view.studio.nice import ui
from train.view.studio.state import Studio

EVERYTHING = frozenset({"problem", "imitation", "side 0", "side 1", "mass"})


class Window:
    """One window that shows the state.

    Attributes:
        studio: the state.
        waiting: news that are not shown yet.
        controls: what each control shows of the problem's file.
        tellers: that say in words how things are.
        filling: whether the controls are being filled, and ask for nothing.
        given_up: what follows if the window is closed before the pointer is let go; None where it holds nothing.
        push: puts the mass to the start, with the settings of this window.
    """

    def __init__(self, studio: Studio) -> None:
        self.studio = studio
        self.waiting: set[str] = set()
        self.controls: dict[Any, Callable[[dict[str, Any]], Any]] = {}
        self.tellers: list[Callable[[], object]] = []
        self.filling = False
        self.given_up: Callable[[], object] | None = None
        self.push: Callable[[], object] = lambda: None

    def news(self, what: str) -> None:
        """Something to be shown with the next picture; with another problem, everything."""
        self.waiting |= EVERYTHING if what == "problem" else {what}

    def leave(self) -> None:
        """The window is closed: what its pointer held is let go, that of other windows is not."""
        self.studio.views.remove(self)
        if self.given_up is not None:
            self.given_up()

    def attempt(self, call: Callable[[], object]) -> None:
        """Do it, or say why not."""
        try:
            call()
        except TorchdsError as error:
            said = " ".join(str(error).split())
            ui.notify(said, type="negative", multi_line=True, close_button="OK", timeout=12000, position="top")

    def change(self, **fields: Any) -> None:
        """Other values for fields of the problem, or why not."""
        self.attempt(lambda: self.studio.change(**fields))

    def fill(self) -> None:
        """Show the problem in all controls."""
        self.filling, p = True, self.studio.problem.to_json()
        try:
            for element, read in self.controls.items():
                element.value = read(p)
        finally:
            self.filling = False
