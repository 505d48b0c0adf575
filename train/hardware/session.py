"""A policy search on the digging task that waits for a robot, in a folder.

`ask` writes the motions to execute into it, `tell` reads what the robot measured and makes the update; days may lie between
them. All that a session remembers is in one file that is replaced as a whole, so that a kill at any point loses nothing: the
command is given again.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

import tasks
from tasks.base import total
from tasks.digging import lwr
from tasks.digging.task import LwrDigging
from torchds import Rollout, files
from torchds.errors import AllRolloutsFailedError, FileError, InvalidArgumentError, UnknownNameError
from torchds.locks import one_writer
from train.folder import RunFolder, load, make_folder, say_versions, versions
from train.hardware.evidence import Evidence, refuse_gross
from train.hardware.given import STATE, check_given, give, refuse_used
from train.hardware.records import Asked, Status, Told, hint
from train.hardware.robot_files import COSTS, State, failure, reference, reference_text, returned, write_table
from train.learning.history import results
from train.learning.learner import Learner
from train.learning.run import check
from train.options import RunOptions, options_class

DEMONSTRATIONS, MIXTURE = "demonstrations.npz", "mixture.npz"  # kept, since those that were given may change
BOOKS = ("asked", "given", "attempt", "spent", "failed")  # what a session keeps beside its learner


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
        given: id of the references that were given out last; they and the state have it.
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
        self.asked, self.given, self.attempt, self.spent, self.failed = False, "", 1, 0, 0
        self._written = ""  # digest of the state as this object knows it

    @classmethod
    def start(cls, folder: Path, options: RunOptions) -> Session:
        """Begin a session in a new folder.

        Raises:
            InvalidArgumentError: one is there already, or options do not fit.
        """
        refuse_used(folder)
        session = cls(folder, options, made(**options.task_options()))
        make_folder(folder)
        with one_writer(folder):
            refuse_used(folder)  # by somebody else, since
            session.task.demonstrations.save_npz(folder / DEMONSTRATIONS)
            session.task.mixture.save(folder / MIXTURE)
            session.save()
        return session

    @classmethod
    def open(cls, folder: Path) -> Session:
        """The session in a folder, where it was left.

        Raises:
            InvalidArgumentError: there is none.
            FileError: one of its files is damaged, or not the one that it began with.
        """
        path = folder / STATE
        if not path.is_file():
            raise InvalidArgumentError(f"{folder} holds no session; {hint('start', folder)}")
        state = load(path, "session", ("options", "versions", "kept", "learner", *BOOKS))
        for name, written in state["kept"].items():
            if hashlib.sha256(files.existing(folder / name).read_bytes()).hexdigest() != written:
                raise FileError(f"{folder / name} is damaged, or not the one that the session began with")
        say_versions(path, state["versions"])
        try:
            options = options_class("lwr_digging").from_json(state["options"])
            kept = {"demonstrations": folder / DEMONSTRATIONS, "mixture": folder / MIXTURE}
            session = cls(folder, options, made(**options.task_options() | kept))
            session.learner.load_state_dict(state["learner"])
        except (InvalidArgumentError, UnknownNameError) as error:
            raise FileError(f"{path} is no session of this version: {error}") from error
        for name in BOOKS:
            setattr(session, name, state[name])
        session._written = files.digest(state)
        return session

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Be the only one who changes the session, and know it as it is.

        Raises:
            FileError: another process works on it, or has gone on with it since it was opened here.
        """
        with one_writer(self.folder):
            if files.digest(files.load(self.folder / STATE, "session")) != self._written:
                raise FileError(
                    f"{self.folder}: another process has gone on with the session since it was opened; open it again"
                )
            yield

    def save(self) -> None:
        """Write results and policy, then the state: before that moment the command did not happen."""
        history = self.learner.history
        run = RunFolder(self.folder)
        run.write_results(results(self.options.task, self.options.to_json(), history))
        run.save_policy(self.learner.policy, self.learner.task)
        kept = {
            name: hashlib.sha256((self.folder / name).read_bytes()).hexdigest() for name in (DEMONSTRATIONS, MIXTURE)
        }
        said = {"options": self.options.to_json(), "versions": versions(), "kept": kept}
        state = {**said, "learner": self.learner.state_dict(), **{name: getattr(self, name) for name in BOOKS}}
        files.save(self.folder / STATE, "session", state)
        self._written = files.digest(state)

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
            FileError: another process works on the session or has gone on with it, or other references are there.
        """
        with self.alone():
            return self._ask()

    def _ask(self) -> Asked:
        if self.done >= self.learner.n_updates:
            raise InvalidArgumentError(f"{self.folder}: all {self.done} updates are made, there is nothing to ask")
        if not self.asked:
            self.optim.ask()
            noise = [self.optim.state[p]["noise"] for p in self.learner.policy.parameters()]
            self.asked, self.given = True, files.digest([self.done, self.attempt, noise])[:16]
            self.save()
        path, poses, stiffness = self.references()
        possible = lwr.reaches(*poses.unbind(-1)).all(-1) & stiffness.isfinite().all(-1)
        texts = {}
        for k in range(1, self.optim.n_rollouts + 1):
            if possible[k - 1]:
                text = reference_text(poses[k - 1, 0], path.v[k - 1, 0], stiffness[k - 1, 0], path.dt)
                texts[reference(self.update_folder, k).name] = text
            else:
                texts[failure(self.update_folder, k).name] = "the reference leaves what the arm reaches\n"
        give(self.update_folder, self.given, texts)
        out_of_reach = ((~possible).flatten().nonzero().flatten() + 1).tolist()
        return Asked(self.done + 1, self.learner.n_updates, self.update_folder, self.optim.n_rollouts, out_of_reach)

    def references(self) -> tuple[Rollout, Tensor, Tensor]:
        """What the roll-outs of this update have to follow, `(N, 1)` in front (see `LwrDigging.reference`)."""
        tried = copy.deepcopy(self.learner.policy)
        for p, mine in zip(tried.parameters(), self.learner.policy.parameters(), strict=True):
            p.data = mine.data + self.optim.state[mine]["noise"]
        return self.task.reference(tried)

    # ------------------------------------------------------------------ tell

    def tell(self, missing: Literal["wait", "failed"] = "wait", force: bool = False) -> Told | None:
        """Make the update from what came back; None where nothing is asked, and nothing is changed.

        Args:
            missing: what a roll-out is that has not come back.
            force: take recordings that do not look like their references.

        Raises:
            InvalidArgumentError: roll-outs are missing, or costs come where recordings came before or the other way round.
            FileError: a file that cannot be used, recordings that are not those of their references, or another process that
                works on the session or has gone on with it.
            AllRolloutsFailedError: no roll-out has a cost; the policy stays, and the session can ask again.
        """
        with self.alone():
            return self._tell(missing, force) if self.asked else None

    def _tell(self, missing: Literal["wait", "failed"], force: bool) -> Told:
        check_given(self.update_folder, self.given)
        states = returned(self.update_folder, self.optim.n_rollouts)
        if missing == "wait" and "missing" in states:
            status = self.status()
            raise InvalidArgumentError(f"{status.returned}; nothing is changed. {status.next}")
        evidence = self.evidence(states)
        _, poses, stiffness = self.references()
        findings = evidence.questions(poses[:, 0], stiffness[:, 0])
        if not force:
            refuse_gross(self.update_folder, findings, f"{hint('tell', self.folder)} --force True")
        seen: dict[str, Tensor] = {}

        def closure() -> Tensor:
            seen.update(evidence.terms(self.learner.policy))
            return total(seen.values())

        try:
            self.learner.searcher.step(closure)
        except AllRolloutsFailedError as error:
            self.asked, self.attempt, self.failed = False, self.attempt + 1, self.failed + self.optim.n_rollouts
            self.spent += self.optim.n_rollouts
            self.save()
            raise AllRolloutsFailedError(
                f"all roll-outs failed; the policy stays as it is. {self.status().next}"
            ) from error
        return self.finish({name: values[:, 0] for name, values in seen.items()}, states, [str(f) for f in findings])

    def evidence(self, states: list[State]) -> Evidence:
        """What came back.

        Raises:
            InvalidArgumentError: costs where there were recordings before or the other way round: they do not compare.
            FileError: see `Evidence`.
        """
        evidence = Evidence(self.task, self.update_folder, states)
        before = set(self.learner.history.terms) - {"control"}
        if before and before != evidence.names:
            raise InvalidArgumentError(
                f"{self.update_folder}: a session is told recordings or {COSTS} all along; here the terms would be "
                f"{', '.join(sorted(evidence.names))} after {', '.join(sorted(before))}"
            )
        return evidence

    def finish(self, terms: dict[str, Tensor], states: list[State], notes: list[str]) -> Told:
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
        history.add(self.spent, nominal, self.failed, computed)
        self.spent += self.optim.n_rollouts
        history.seconds += states.count("there") * self.task.seconds
        self.failed, self.asked, self.attempt = self.learner.searcher.failed, False, 1
        self.save()
        return Told(self.done, self.learner.n_updates, self.failed, header, rows, notes)

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
