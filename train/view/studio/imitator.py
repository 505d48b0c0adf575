"""Who asks for the system of a drawing: one drawing at a time, the latest one next."""

from __future__ import annotations

from tasks.sketch import Problem
from train.view.studio.imitating import Imitation, imitate
from train.view.studio.worker import Failed, Worker


class Imitator:
    """A process that imitates, and what it was last asked for.

    It is told a drawing when it has answered the one before: a pipe that fills while a fit takes seconds lets the page wait.

    Attributes:
        awaited: whether an answer to the latest drawing is still to come.
    """

    def __init__(self) -> None:
        self.awaited = False
        self._asked = 0
        self._latest: Problem | None = None
        self._told: Problem | None = None  # and not answered
        self._worker = Worker(imitate)

    def ask(self, problem: Problem | None) -> None:
        """What was asked for before does not matter any more; with None, nothing does."""
        self._asked += 1
        self._latest, self.awaited = problem, problem is not None
        self._tell()

    def _tell(self) -> None:
        if self.awaited and self._told is None:
            self._told = self._latest
            self._worker.tell((self._asked, self._told))

    def heard(self) -> Imitation | Failed | None:
        """The answer to the latest drawing, once it has come. A process that was killed is replaced, and asked again."""
        found = None
        while answers := self._worker.answers():
            for number, answer in answers:
                self._told = None
                if number == self._asked:
                    found, self.awaited = answer, False
            self._tell()
        if answers is None:
            self._worker.end()
            self._worker, self._told = Worker(imitate), None
            self._tell()
        return found

    def end(self) -> None:
        """Let the process go."""
        self._worker.end()
