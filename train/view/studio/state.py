"""What the page is about: the problem, what it was before, what was made of it, and who looks at it."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

from tasks import Task
from tasks.sketch import Problem, Sketch, examples
from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError, TorchdsError
from train.folder import make_folder
from train.view.studio import changes, kept
from train.view.studio.imitating import Imitation, imitate
from train.view.studio.learning import Picture
from train.view.studio.pushing import Execution, Pushed
from train.view.studio.side import Side
from train.view.studio.table import TABLE, near, points, seen
from train.view.studio.worker import Failed, Worker

FIRST = "an_s"  # of the examples
SERIES = 1.0  # s between two changes of one slider
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
        sides: the two learners.
        pushed: the mass that can be pulled at; None where there is none.
        table: what is seen of the plane, left, right, low and high.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make_folder(folder)
        self.problem, runs = kept.read(folder) or (Problem.read(examples()[FIRST]), [])
        self.past: list[Problem] = []
        self.future: list[Problem] = []
        self.views: list[View] = []
        self.imitation: Imitation | None = None
        self.complaint = ""
        self.sides = [Side(i, folder.parent) for i in range(2)]
        self.pushed: Pushed | None = None
        self.table = TABLE
        self._adjusted: tuple[tuple[str, ...], float] = ((), 0.0)
        self._task: Task | None = None
        self._asked = 0
        self._imitator = Worker(imitate)
        for side, run in zip(self.sides, runs, strict=False):
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
            InvalidArgumentError: a value that it cannot have; nothing is changed.
        """
        self.put(replace(self.problem, **fields))

    def adjust(self, **fields: Any) -> None:
        """The same, where a series of changes of the same fields, by a slider, is undone at once."""
        now, names = time.monotonic(), tuple(fields)
        series = names == self._adjusted[0] and now - self._adjusted[1] < SERIES
        self.change(**fields)
        if series and len(self.past) > 1:
            self.past.pop()
        self._adjusted = names, now

    def put(self, problem: Problem) -> None:
        """Another problem, which can be undone."""
        if problem != self.problem:
            self.past.append(self.problem)
            self.future.clear()
            self._set(problem)

    def undo(self) -> None:
        """The problem as it was before the last change."""
        if self.past:
            self.future.append(self.problem)
            self._set(self.past.pop())

    def redo(self) -> None:
        """What was undone last."""
        if self.future:
            self.past.append(self.problem)
            self._set(self.future.pop())

    def _set(self, problem: Problem) -> None:
        before, self.problem = self.problem, problem
        self.keep()
        for side in self.sides:
            if side.running and side.stale(problem):
                side.pause()
        if replace(before, learners=problem.learners, name=problem.name) != problem:
            self._renewed()
        self.tell("problem", "side 0", "side 1")

    def _renewed(self) -> None:
        """Another drawing: the table, the task, and what is to be imitated."""
        self._task = None
        self.table = seen(points(self.problem), self.table)
        self.imitate(self.problem)

    def imitate(self, problem: Problem) -> None:
        """Ask for the system of a drawing, this one or one that is still being drawn."""
        self._asked += 1
        if problem.strokes:
            return self._imitator.tell((self._asked, problem))
        self.imitation, self.pushed, self.complaint = None, None, ""
        self.tell("imitation", "mass")

    # ------------------------------------------------------------------ what the pointer does

    def draw(self, points: list[list[float]], done: bool) -> None:
        """A stroke of the pointer, see `changes.stroke`; the system follows before it is done.

        Raises:
            InvalidArgumentError: a stroke that says nothing, once it is done.
        """
        fields = changes.stroke(self.problem, points)
        if done:
            changes.complete(points)
            return self.change(**fields)
        with contextlib.suppress(TorchdsError):  # it has just begun
            self.imitate(replace(self.problem, **fields))

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

    @torch.no_grad()
    def motion(self, policy: GMRPolicy, start: Tensor | None = None, goal: Tensor | None = None) -> Tensor:
        """`(T+1, 2)` the motion of a policy, as if it began or ended elsewhere."""
        task = self.task
        assert task is not None
        x0, n_steps, dt = task.motion()
        shift = None if goal is None else goal - task.scene().goal
        x = rollout(
            policy,
            x0 if start is None else start,
            n_steps,
            dt,
            stop=task.stop,
            plant=task.plant,
            feedback=task.feedback,
            shift=shift,
        ).x
        return x.reshape(-1, *x.shape[-2:])[0]

    def push(self, execution: Execution, stiffness: float, index: int = 0) -> None:
        """Put the mass to the start of the motion, to be pulled at.

        Raises:
            InvalidArgumentError: nothing is drawn.
        """
        policy, task = self.policy(index), self.task
        if policy is None or task is None:
            raise InvalidArgumentError("there is no motion yet; draw one first")
        x0, n_steps, dt = task.motion()
        self.pushed = Pushed(policy, x0, execution, stiffness, n_steps * dt)
        self.tell("mass")

    # ------------------------------------------------------------------ learning

    def go(self, pace: float) -> None:
        """Let both sides learn, anew where the problem is another one, so many updates a second.

        Raises:
            TorchdsError: nothing is drawn, or options that do not fit.
        """
        for side in self._learning():
            if side.problem is None or side.stale(self.problem):
                side.begin(self.problem)
            side.go(pace)
        self.keep()

    def step(self) -> None:
        """One update of both sides; as for `go`."""
        for side in self._learning():
            if side.problem is None or side.stale(self.problem):
                side.begin(self.problem)
            side.step()
        self.keep()

    def pause(self) -> None:
        """Stop both sides after this update."""
        for side in self.sides:
            side.pause()

    def reset(self) -> None:
        """Begin anew, paused; the runs before stay in their folders."""
        for side in self._learning():
            side.begin(self.problem)
        self.keep()
        self.tell("side 0", "side 1")

    def _learning(self) -> list[Side]:
        if not self.problem.strokes:
            raise InvalidArgumentError("nothing is drawn yet; draw a motion first")
        return self.sides[: len(self.problem.learners)]

    # ------------------------------------------------------------------ time

    def tick(self, seconds: float) -> None:
        """Hear what has come, and let the mass move on."""
        answers = self._imitator.answers()
        if answers is None:  # it was killed
            self._imitator.end()
            self._imitator = Worker(imitate)
            self.imitate(self.problem)
        for number, answer in answers or ():
            if number == self._asked:
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
        self.keep()
        for side in self.sides:
            side.end()
        self._imitator.end()
