"""What the page is about: the problem, what it was before, what was made of it, and who looks at it."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import torch

from tasks import Task
from tasks.sketch import Problem, Sketch, examples
from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError, TorchdsError
from train.folder import make_folder
from train.view.studio import changes, kept
from train.view.studio.history import History
from train.view.studio.imitating import Imitation
from train.view.studio.imitator import Imitator
from train.view.studio.learning import Picture
from train.view.studio.pushing import Execution, Pushed
from train.view.studio.side import Side, check_learners
from train.view.studio.table import TABLE, near, points, seen
from train.view.studio.worker import Failed

FIRST = "an_s"  # of the examples
REACH, MOMENT = 0.25, 0.3  # table widths; s


class View(Protocol):
    """Somebody who looks at it."""

    def news(self, what: str) -> None:
        """Something has changed: "problem", "imitation", "side 0", "side 1" or "mass"."""


class Studio:
    """One problem, whoever looks at it from however many windows; every change is kept at once.

    Args:
        folder: where the state is kept, and found again.

    Attributes:
        problem: as it is now.
        imitation: what was last made of the drawing; None where nothing could be.
        complaint: why nothing could be, a sentence.
        history: for undo and redo.
        sides: the two learners.
        pushed: the mass that can be pulled at; None where there is none.
        table: what is seen of the plane, left, right, low and high.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make_folder(folder)
        self.problem, runs = kept.read(folder) or (Problem.read(examples()[FIRST]), [])
        self.history = History()
        self.views: list[View] = []
        self.imitation: Imitation | None = None
        self.complaint = ""
        self.sides = [Side(i, folder.parent) for i in range(2)]
        self.pushed: Pushed | None = None
        self.table = TABLE
        self._sketching = False  # whether the system is asked for of a stroke that is not done
        self._task: Task | None = None
        self._imitator = Imitator()
        for side, run in zip(self.sides[: len(self.problem.learners)], runs, strict=False):
            if run is not None:
                with contextlib.suppress(TorchdsError):  # it was removed
                    side.resume(run)
        self._renewed()

    def keep(self) -> None:
        """Write the state."""
        kept.write(self.folder, self.problem, [side.folder for side in self.sides])

    # ------------------------------------------------------------------ the problem

    def change(self, **fields: Any) -> None:
        """Other values for fields of the problem.

        Raises:
            InvalidArgumentError, UnknownNameError: a value that it cannot have; nothing is changed.
        """
        self.put(replace(self.problem, **fields))

    def adjust(self, **fields: Any) -> None:
        """The same, where a series of changes of the same fields, by a slider, is undone at once."""
        before = self.problem
        self.change(**fields)
        self.history.join(tuple(fields), before, self.problem)

    def put(self, problem: Problem) -> None:
        """Another problem, which can be undone.

        Raises:
            InvalidArgumentError, UnknownNameError: an option of a learner that the training command would refuse.
        """
        check_learners(problem)
        if problem != self.problem:
            self.history.add(self.problem)
            self._set(problem)

    def undo(self) -> None:
        """The problem as it was before the last change."""
        self._set(self.history.back(self.problem))

    def redo(self) -> None:
        """What was undone last."""
        self._set(self.history.forth(self.problem))

    def _set(self, problem: Problem) -> None:
        before, self.problem = self.problem, problem
        for side in self.sides:
            if side.running and side.stale(problem):
                side.pause()
        if replace(before, learners=problem.learners, name=problem.name) != problem:
            self._renewed()
        self.tell("problem", "side 0", "side 1")
        self.keep()

    def _renewed(self) -> None:
        """Another drawing: the table, the task, and what is to be imitated."""
        self._task = None
        self.table = seen(points(self.problem), self.table)
        self.imitate(self.problem)

    def imitate(self, problem: Problem) -> None:
        """Ask for the system of a drawing, this one or one that is still being drawn."""
        self._imitator.ask(problem if problem.strokes else None)
        if not problem.strokes:
            self.imitation, self.pushed, self.complaint = None, None, ""
        self.tell("imitation", "mass")

    @property
    def imitating(self) -> bool:
        """Whether the system of the drawing as it is now is still to come."""
        return self._imitator.awaited or self._sketching

    # ------------------------------------------------------------------ what the pointer does

    def draw(self, points: list[list[float]], done: bool) -> None:
        """A stroke of the pointer, see `changes.stroke`; the system follows before it is done.

        Raises:
            InvalidArgumentError: a stroke that says nothing, once it is done.
        """
        fields = changes.stroke(self.problem, points)
        if not done:
            with contextlib.suppress(TorchdsError):  # it has just begun
                self.imitate(replace(self.problem, **fields))
                self._sketching = True
            return
        try:
            changes.complete(points)
            self.change(**fields)
            self._sketching = False
        finally:
            self.forget()

    def forget(self) -> None:
        """A stroke that was begun is none: the system is that of the problem again."""
        if self._sketching:
            self._sketching = False
            self.imitate(self.problem)

    def pull(self, at: list[float] | None) -> None:
        """The hand pulls from here, or lets go."""
        if self.pushed is not None:
            self.pushed.hold(None if at is None else torch.tensor(at, dtype=torch.float64))

    def nudge(self, direction: tuple[float, float]) -> None:
        """Pull at the mass for a moment from a quarter of the table's width away."""
        if self.pushed is not None:
            away = REACH * (self.table[1] - self.table[0]) * torch.tensor(direction, dtype=torch.float64)
            self.pushed.hold(self.pushed.at + away, MOMENT)

    def let_go(self) -> None:
        """Take the mass away."""
        self.pushed = None
        self.tell("mass")

    @property
    def task(self) -> Task | None:
        """The task of the problem; None where nothing is drawn."""
        if self._task is None and self.problem.strokes:
            self._task = Sketch.of(self.problem)()
        return self._task

    # ------------------------------------------------------------------ motions

    def fresh(self, index: int) -> Picture | None:
        """What a side has learned of this problem; None where it has not, or of another one."""
        side = self.sides[index]
        return None if side.stale(self.problem) else side.picture

    def policy(self, index: int = 0) -> GMRPolicy | None:
        """What a side has learned, or else what is imitated."""
        picture = self.fresh(index)
        if picture is not None:
            return picture.policy
        return None if self.imitation is None else self.imitation.policy

    def settled(self) -> tuple[GMRPolicy, Task]:
        """What the first side has learned, or else what is imitated, and the task of the problem that it is for.

        Raises:
            InvalidArgumentError: nothing is drawn, or the system of what is drawn is still to come.
        """
        policy, task = self.policy(), self.task
        if self.imitating and self.fresh(0) is None:
            raise InvalidArgumentError("the drawing is still being imitated; try again in a moment")
        if policy is None or task is None:
            raise InvalidArgumentError("there is no motion yet; draw one first")
        return policy, task

    def push(self, execution: Execution, stiffness: float) -> None:
        """Put the mass to the start of the motion, to be pulled at.

        Raises:
            InvalidArgumentError: see `settled`.
        """
        policy, task = self.settled()
        x0, n_steps, dt = task.motion()
        self.pushed = Pushed(policy, x0, execution, stiffness, n_steps * dt)
        self.tell("mass")

    # ------------------------------------------------------------------ learning

    def go(self, pace: float) -> None:
        """Let both sides learn, anew where the problem is another one, so many updates a second.

        Raises:
            TorchdsError: nothing is drawn, or options that do not fit.
        """
        for side in self._begun():
            side.go(pace)

    def step(self) -> None:
        """One update of both sides; as for `go`."""
        for side in self._begun():
            side.step()

    def pause(self) -> None:
        """Stop both sides after this update."""
        for side in self.sides:
            side.pause()

    def reset(self) -> None:
        """Begin anew, paused; the runs before stay in their folders."""
        self._begun(anew=True)

    def _begun(self, anew: bool = False) -> list[Side]:
        """The sides that learn, each with a run of this problem."""
        if not self.problem.strokes:
            raise InvalidArgumentError("nothing is drawn yet; draw a motion first")
        sides = self.sides[: len(self.problem.learners)]
        try:
            for side in sides:
                if anew or side.problem is None or side.stale(self.problem):
                    side.begin(self.problem)
        finally:
            self.keep()
            self.tell("side 0", "side 1")
        return sides

    # ------------------------------------------------------------------ time

    def tick(self, seconds: float) -> None:
        """Hear what has come, and let the mass move on."""
        if (answer := self._imitator.heard()) is not None:
            self.complaint = answer.message if isinstance(answer, Failed) else ""
            self.imitation = None if isinstance(answer, Failed) else answer
            self.tell("imitation")
        for i, side in enumerate(self.sides):
            if side.heard():
                self.tell(f"side {i}")
        if self.pushed is not None:
            self.pushed.go_on(min(seconds, 0.1))
            if self.pushed.lost or not near(self.pushed.at, self.table):
                self.pushed = None
            self.tell("mass")

    def tell(self, *news: str) -> None:
        """Let everybody know who looks."""
        for view in self.views:
            for what in news:
                view.news(what)

    def end(self) -> None:
        """Let all processes go."""
        for side in self.sides:
            side.end()
        self._imitator.end()
        self.keep()
