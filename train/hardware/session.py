"""A policy search on the digging task that waits for a robot, in a folder.

`ask` writes the motions to execute into it, `tell` reads what the robot measured and makes the update; days may lie between
them. All that a session remembers is in one file that is replaced as a whole, so that a kill at any point loses nothing: the
command is given again.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

import tasks
from tasks.base import total
from tasks.digging import lwr
from tasks.digging.simulation import WEIGHING, Recording
from tasks.digging.task import LwrDigging
from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from train.folder import RunFolder, save_state
from train.hardware.records import Asked, Status, Told, hint
from train.hardware.robot_files import (
    COSTS,
    State,
    failure,
    read_costs,
    read_recordings,
    reference,
    returned,
    write_reference,
    write_table,
)
from train.learning.history import results
from train.learning.learner import Learner
from train.learning.run import check
from train.options import RunOptions, options_class

STATE = "session.pt"
DEMONSTRATIONS, MIXTURE = "demonstrations.npz", "mixture.npz"  # kept, since those that were given may change


class Session:
    """A policy search that waits for a robot; `start` begins one, `open` continues it.

    The first roll-out of an update is the policy as it is. What it costs is the history of the session: the policy after the
    last update has no cost until it is tried.

    Args:
        folder: of the session.
        options: of the search.
        task: that they name.

    Attributes:
        learner: task, policy `(1,)` and search; its trials in simulation are not used.
        asked: whether roll-outs were given out and have not been told.
        attempt: of this update, from 1; another one follows where all roll-outs failed.
        spent: roll-outs so far.
        failed: how many of them failed since the last line of the history.

    Raises:
        InvalidArgumentError: options that a robot cannot be learned with.
    """

    def __init__(self, folder: Path, options: RunOptions, task: LwrDigging) -> None:
        check(options)
        if options.runs != 1 or options.cost_noise or options.elite not in (None, "nominal"):
            raise InvalidArgumentError(
                "a robot learns in one run, without added noise, and tries the policy itself first; got "
                f"runs={options.runs}, cost_noise={options.cost_noise}, elite={options.elite!r}"
            )
        self.folder, self.options, self.task = folder, options, task
        self.learner = Learner(options, task)
        optim = self.learner.searcher.optim
        if optim is None or optim.costs_per_step:
            raise InvalidArgumentError(f"--optimizer {options.optimizer} cannot wait for a robot; use --optimizer pibb")
        self.optim = optim
        self.asked, self.attempt, self.spent, self.failed = False, 1, 0, 0

    @classmethod
    def start(cls, folder: Path, options: RunOptions) -> Session:
        """Begin a session in a new folder.

        Raises:
            InvalidArgumentError: one is there already, or options do not fit.
        """
        if (folder / STATE).exists() or list(folder.glob("update-*")):
            raise InvalidArgumentError(f"{folder} holds a session already; {hint('status', folder)}")
        session = cls(folder, options, made(**options.task_options()))
        folder.mkdir(parents=True, exist_ok=True)
        session.task.demonstrations.save_npz(folder / DEMONSTRATIONS)
        session.task.mixture.save(folder / MIXTURE)
        session.save()
        return session

    @classmethod
    def open(cls, folder: Path) -> Session:
        """The session in a folder, where it was left.

        Raises:
            InvalidArgumentError: there is none.
        """
        if not (folder / STATE).is_file():
            raise InvalidArgumentError(f"{folder} holds no session; {hint('start', folder)}")
        state = torch.load(folder / STATE, weights_only=True)
        options = options_class("lwr_digging").from_json(state["options"])
        kept = {"demonstrations": folder / DEMONSTRATIONS, "mixture": folder / MIXTURE}
        session = cls(folder, options, made(**options.task_options() | kept))
        session.learner.load_state_dict(state["learner"])
        for name in ("asked", "attempt", "spent", "failed"):
            setattr(session, name, state[name])
        return session

    def save(self) -> None:
        """Write results and policy, then the state: before that moment the command did not happen."""
        history = self.learner.history
        run = RunFolder(self.folder)
        run.write_results(results(self.options.task, self.options.to_json(), history))
        run.save_policy(self.learner.policy.state_dict())
        books = {name: getattr(self, name) for name in ("asked", "attempt", "spent", "failed")}
        state = {"options": self.options.to_json(), "learner": self.learner.state_dict(), **books}
        save_state(self.folder / STATE, state)

    @property
    def done(self) -> int:
        """Updates made so far."""
        return len(self.learner.history.cost)

    @property
    def update_folder(self) -> Path:
        """Of the files of the update to come."""
        again = f".{self.attempt}" if self.attempt > 1 else ""
        return self.folder / f"update-{self.done + 1:03d}{again}"

    # ------------------------------------------------------------------ ask

    def ask(self) -> Asked:
        """Write the roll-outs of the next update, the same ones until they are told.

        A reference that the arm cannot reach is not written, and marked as failed.

        Raises:
            InvalidArgumentError: all updates are made.
        """
        if self.done >= self.learner.n_updates:
            raise InvalidArgumentError(f"{self.folder}: all {self.done} updates are made, there is nothing to ask")
        if not self.asked:
            self.optim.ask()
            self.asked = True
            self.save()
        tried = copy.deepcopy(self.learner.policy)
        for p, mine in zip(tried.parameters(), self.learner.policy.parameters(), strict=True):
            p.data = mine.data + self.optim.state[mine]["noise"]
        path, poses, stiffness = self.task.reference(tried)  # (N, 1, ...)
        possible = lwr.reaches(*poses.unbind(-1)).all(-1) & stiffness.isfinite().all(-1)
        self.update_folder.mkdir(exist_ok=True)
        for k in range(1, self.optim.n_rollouts + 1):  # files
            if possible[k - 1]:
                file = reference(self.update_folder, k)
                write_reference(file, poses[k - 1, 0], path.v[k - 1, 0], stiffness[k - 1, 0], path.dt)
            else:
                failure(self.update_folder, k).write_text("the reference leaves what the arm reaches\n")
        out_of_reach = ((~possible).flatten().nonzero().flatten() + 1).tolist()
        return Asked(self.done + 1, self.learner.n_updates, self.update_folder, self.optim.n_rollouts, out_of_reach)

    # ------------------------------------------------------------------ tell

    def tell(self, missing: Literal["wait", "failed"] = "wait") -> Told | None:
        """Make the update from what came back; None where nothing is asked, and nothing is changed.

        Args:
            missing: what a roll-out is that has not come back.

        Raises:
            InvalidArgumentError: roll-outs are missing, or costs come where recordings came before or the other way round.
            FileError: a file that cannot be used.
            AllRolloutsFailedError: no roll-out has a cost; the policy stays, and the session can ask again.
        """
        if not self.asked:
            return None
        states = returned(self.update_folder, self.optim.n_rollouts)
        if missing == "wait" and "missing" in states:
            status = self.status()
            raise InvalidArgumentError(f"{status.returned}; nothing is changed. {status.next}")
        terms = self.measured(states)
        seen: dict[str, Tensor] = {}

        def closure() -> Tensor:
            seen.update(terms())
            return total(seen.values())

        self.spent += self.optim.n_rollouts
        try:
            self.learner.searcher.step(closure)
        except AllRolloutsFailedError as error:
            self.asked, self.attempt, self.failed = False, self.attempt + 1, self.failed + self.optim.n_rollouts
            self.save()
            raise AllRolloutsFailedError(
                f"all roll-outs failed; the policy stays as it is. {self.status().next}"
            ) from error
        return self.finish({name: values[:, 0] for name, values in seen.items()}, states)

    def measured(self, states: list[State]) -> Callable[[], dict[str, Tensor]]:
        """Read what came back; the result gives the cost terms `(N, 1)` while the policy carries its noise."""
        task, policy, folder = self.task, self.learner.policy, self.update_folder
        there = torch.tensor([state == "there" for state in states])
        if (folder / COSTS).is_file():
            self.same_terms({"measured"})
            costs = read_costs(folder / COSTS, len(states))
            values = [costs[k] if state == "there" else torch.inf for k, state in enumerate(states, 1)]
            measured = torch.tensor(values, dtype=task.start.dtype).unsqueeze(-1)

            def given() -> dict[str, Tensor]:
                task.reference(policy)  # reports what it visits, for the control cost
                return {"measured": measured}

            return given

        dt = task.dt
        pose, force = (
            field.unsqueeze(1) for field in read_recordings(folder, states, task.start, task.motion().n_steps, dt)
        )
        load = force[..., -round(WEIGHING / dt) :, 2].mean(-1)

        def terms() -> dict[str, Tensor]:
            path, _, stiffness = task.reference(policy)
            unused = pose.new_zeros(0)
            plant = Recording(pose, force, unused, stiffness, load, unused, ~there.unsqueeze(-1))
            return task.cost_terms(replace(path, x=pose, v=pose.diff(dim=-2) / dt, plant=plant))

        self.same_terms({"gravel", "goal", "force", "stiffness", "acceleration"})
        return terms

    def same_terms(self, names: set[str]) -> None:
        """Refuse to change between recordings and costs, whose histories do not compare.

        Raises:
            InvalidArgumentError: the update before had other terms.
        """
        before = set(self.learner.history.terms) - {"control"}
        if before and before != names:
            raise InvalidArgumentError(
                f"{self.update_folder}: a session is told recordings or {COSTS} all along; here the terms would be "
                f"{', '.join(sorted(names))} after {', '.join(sorted(before))}"
            )

    def finish(self, terms: dict[str, Tensor], states: list[State]) -> Told:
        """Enter the update into the books, from the cost terms `(N,)` of its roll-outs."""
        last, history = self.optim.last, self.learner.history
        assert last is not None
        terms = {**terms, "control": last.control[:, 0]}
        numbers = torch.stack([*terms.values(), last.cost[:, 0], last.weights[:, 0]], -1).tolist()
        header = ["rollout", *terms, "cost", "weight", "state"]
        rows = [[k, *row, state] for k, (row, state) in enumerate(zip(numbers, states, strict=True), 1)]
        write_table(self.update_folder / "outcome.csv", header, rows)
        nominal = {name: values[:1] for name, values in terms.items()}
        computed = self.learner.searcher.forward_equivalents(self.done)
        history.add(self.spent - self.optim.n_rollouts, nominal, self.failed, computed)
        history.seconds += states.count("there") * self.task.seconds
        self.failed, self.asked, self.attempt = self.learner.searcher.failed, False, 1
        self.save()
        return Told(self.done, self.learner.n_updates, self.failed, header, rows)

    # ------------------------------------------------------------------ status

    def status(self) -> Status:
        """Where the session stands, what it has cost so far, and what comes next."""
        folder, history, n = self.update_folder, self.learner.history, self.optim.n_rollouts
        states = returned(folder, n) if self.asked else None
        return Status(self.folder, self.done, self.learner.n_updates, self.spent, history, folder, states)


def made(**options: Any) -> LwrDigging:
    """The digging task with these options."""
    task = tasks.make("lwr_digging", **options)
    assert isinstance(task, LwrDigging)
    return task
