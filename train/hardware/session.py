"""A policy search on a task that waits for a robot, in a folder (see `torchds.sessions`)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import Tensor

import tasks
from tasks.base import rolls_out_itself
from torchds import GMRPolicy, files, sessions
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.files import make_folder
from torchds.locks import one_writer
from torchds.sessions.books import BOOKS, Books
from torchds.sessions.given import STATE, refuse_used
from train.folder import RunFolder, load, say_versions, versions
from train.hardware.records import Status, hint
from train.learning.history import History, results
from train.learning.learner import Learner
from train.learning.run import check
from train.options import RunOptions, options_class

DIGGING = "lwr_digging"
DEMONSTRATIONS, MIXTURE = "demonstrations.npz", "mixture.npz"  # kept, since those that were given may change


class Session(Books):
    """A policy search that waits for a robot; `start` begins one, `open` continues it.

    Args:
        folder: of the session.
        options: of the search.
        task: that they name.

    Attributes:
        learner: task, policy `(1,)` and search; its trials in simulation are not used.

    Raises:
        InvalidArgumentError: options that a robot cannot be learned with.
    """

    says = Status

    def __init__(self, folder: Path, options: RunOptions, task: tasks.Task) -> None:
        check(options)
        if options.runs != 1 or options.cost_noise or options.elite not in (None, "nominal"):
            raise InvalidArgumentError(
                "a robot learns in one run, without added noise, and tries the policy itself first; got "
                f"runs={options.runs}, cost_noise={options.cost_noise}, elite={options.elite!r}"
            )
        self.options, self.task, self.learner = options, task, Learner(options, task)
        optim = self.learner.searcher.optim
        if optim is None or optim.costs_per_step:
            raise InvalidArgumentError(f"--optimizer {options.optimizer} cannot wait for a robot; use --optimizer pibb")
        super().__init__(folder, trial_of(task), self.learner.policy, optim, self.learner.n_updates)

    @classmethod
    def start(cls, folder: Path, options: RunOptions) -> Session:
        """Begin a session in a new folder.

        Raises:
            InvalidArgumentError: one is there already, or options do not fit.
        """
        refuse_used(folder, hint("status", folder))
        session = cls(folder, options, options.make_task())
        make_folder(folder)
        with one_writer(folder):
            refuse_used(folder, hint("status", folder))  # by somebody else, since
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
            options = options_class(state.get("task", DIGGING)).from_json(state["options"])
            kept = {"demonstrations": folder / DEMONSTRATIONS, "mixture": folder / MIXTURE}
            session = cls(folder, options, tasks.make(options.task, **options.task_options() | kept))
            session.learner.load_state_dict(state["learner"])
        except (InvalidArgumentError, UnknownNameError) as error:
            raise FileError(f"{path} is no session of this version: {error}") from error
        session._read(state)
        return session

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
        task = {} if self.options.task == DIGGING else {"task": self.options.task}
        self._write({**said, **task, "learner": self.learner.state_dict()})

    def _about(self, policy: GMRPolicy) -> dict[str, Any]:
        return {**self.task.about(policy), "names": super()._about(policy)["names"]}

    @property
    def history(self) -> History:
        """What the updates cost so far."""
        return self.learner.history

    def _step(self, closure: Callable[[], Tensor]) -> None:
        self.learner.searcher.step(closure)

    def _enter(self, terms: dict[str, Tensor], n_there: int) -> int:
        nominal = {name: values[:1] for name, values in terms.items()}
        computed = self.learner.searcher.forward_equivalents(self.done)
        self.history.add(self.spent, nominal, self.failed, computed)
        self.history.seconds += n_there * self.trial.seconds
        return self.learner.searcher.failed


def trial_of(task: tasks.Task) -> sessions.Trial:
    """What a roll-out of a task is.

    Raises:
        InvalidArgumentError: the task has a plant, whose fields its cost reads, and which the robot would replace; or it rolls
            out in a way of its own, which a session does not know.
    """
    if task.name == DIGGING:
        from train.hardware.trial import Trial  # needs MuJoCo

        return Trial(task)  # type: ignore[arg-type] # the name says what it is
    policy = task.policy()
    if rolls_out_itself(task, policy):
        raise InvalidArgumentError(
            f"a robot is asked for `torchds.rollout` of a policy, got {task.name!r} with a rollout of its own; take the task "
            "with a GMRPolicy (via_point: --system gmr), or make a torchds.sessions.Session with a Trial of your own"
        )
    if task.plant is not None or policy.stiffness_dim:
        raise InvalidArgumentError(
            f"{task.name} simulates what a robot would be; make a torchds.sessions.Session with cost_terms of recordings"
        )
    return sessions.Trial.of(task)
