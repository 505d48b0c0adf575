"""One of the two learners of the page: its run, the process that learns, and what was last heard of it."""

from __future__ import annotations

import re
import shutil
import unicodedata
from dataclasses import fields, replace
from pathlib import Path

from tasks.sketch import Problem
from torchds.errors import TorchdsError
from train.folder import RunFolder
from train.learning.run import check
from train.options import RunOptions, options_class
from train.view.studio.learning import Picture, learn
from train.view.studio.worker import Failed, Worker

PROBLEM = "problem.json"
LEARNED = [field.name for field in fields(Problem) if field.name not in ("name", "learners")]  # what a run is about


def stem(problem: Problem) -> str:
    """Its name, fit for a file: in plain letters, without accents; "drawing" where none are left."""
    plain = unicodedata.normalize("NFKD", problem.name).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "_", plain).strip("_") or "drawing"


def check_learners(problem: Problem) -> None:
    """Refuse options of learners as the training command does, before anything of them is shown or run.

    Raises:
        InvalidArgumentError: a value that an option cannot have.
        UnknownNameError: an option, or a name in one, that does not exist.
    """
    for learner in problem.learners:
        check(RunOptions.from_json(learner))


class Side:
    """A learning run beside the page. It is one of a problem with one learner, kept in its folder.

    Args:
        index: which of the problem's learners.
        logdir: below which its runs are.

    Attributes:
        folder: of the run; None before the first.
        problem: that is learned; None before the first run.
        picture: the last one that came; None before it.
        complaint: why it does not go on, a sentence; empty where it does.
        running: whether it was told to make updates by itself.
    """

    def __init__(self, index: int, logdir: Path) -> None:
        self.index, self.logdir = index, logdir
        self.folder: Path | None = None
        self.problem: Problem | None = None
        self.picture: Picture | None = None
        self.complaint = ""
        self.running = False
        self._worker: Worker | None = None

    # ------------------------------------------------------------------ what it is asked

    def wanted(self, problem: Problem) -> Problem:
        """The problem with this side's learner alone."""
        return replace(problem, learners=(problem.learners[self.index],))

    def stale(self, problem: Problem) -> bool:
        """Whether its run is of another problem, or with other settings or none; what the problem is called does not matter."""
        own = self.problem
        return own is not None and (
            own.learners != problem.learners[self.index : self.index + 1]
            or any(getattr(own, name) != getattr(problem, name) for name in LEARNED)
        )

    def begin(self, problem: Problem) -> None:
        """Begin anew, paused; the run before stays where it is.

        Args:
            problem: with a learner for this side.

        Raises:
            InvalidArgumentError: options that do not fit; the run before goes on.
            FileError: nothing can be written.
        """
        wanted = self.wanted(problem)
        wanted.demonstrations()  # says what is missing before a folder is made
        learner = wanted.learners[0]
        seed = learner.get("seed")
        folder = RunFolder.new(
            self.logdir, stem(wanted), str(learner.get("optimizer", "pibb")), seed if isinstance(seed, int) else 0
        )
        try:
            wanted.write(folder.path / PROBLEM)
            options = options_class(str(folder.path / PROBLEM))()
            check(options)
            folder.begin(options.task, options.to_json())
        except TorchdsError:
            shutil.rmtree(folder.path, ignore_errors=True)
            raise
        if self._worker is not None:
            self._worker.leave()  # it keeps what it has, in a folder of its own, while the next one begins
        self.running = False
        self.resume(folder.path)

    def resume(self, folder: Path) -> None:
        """Go on with the run in a folder, paused."""
        self.problem = Problem.read(folder / PROBLEM)
        self.folder, self.picture, self.complaint = folder, None, ""
        self._worker = Worker(learn, folder)

    def go(self, pace: float) -> None:
        """Make so many updates a second."""
        self._tell("go", pace)
        self.running = True

    def step(self) -> None:
        """Make one update."""
        self._tell("step", None)
        self.running = False

    def pause(self) -> None:
        """Stop after this update."""
        self.running = False
        if self._worker is not None:
            self._worker.tell(("pause", None))

    def end(self) -> None:
        """Let the process go; the run stays in its folder."""
        if self._worker is not None:
            self._worker.end()
        self._worker, self.running = None, False

    def _tell(self, word: str, pace: float | None) -> None:
        if self._worker is None and self.folder is not None:  # it was lost, and goes on where it was
            self.resume(self.folder)
        if self._worker is not None:
            self._worker.tell((word, pace))

    # ------------------------------------------------------------------ what it answers

    def heard(self) -> bool:
        """Take what has come; whether there was anything."""
        if self._worker is None:
            return False
        answers = self._worker.answers()
        if answers is None:
            done = 0 if self.picture is None else self.picture.done
            self.complaint = self.complaint or (
                f"The learner's process has ended. What it had learned after {done} updates is kept: Go goes on there."
            )
            self.end()
            return True
        for answer in answers:
            if isinstance(answer, Failed):
                self.complaint = answer.message
            else:
                self.picture = answer
        return bool(answers)
