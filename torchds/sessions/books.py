"""The books of a policy search that waits for a robot, in a folder.

`ask` writes the motions to execute into it, `tell` reads what the robot measured and makes the update; days may lie between
them. All that a session remembers is in one file that is replaced as a whole, so that a kill at any point loses nothing: the
command is given again.

Stability: experimental.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from torchds import files
from torchds.errors import AllRolloutsFailedError, FileError, InvalidArgumentError
from torchds.locks import one_writer
from torchds.optim.base import PolicySearch
from torchds.policy import GMRPolicy
from torchds.sessions.evidence import Evidence, refuse_gross
from torchds.sessions.given import STATE, check_given, give
from torchds.sessions.records import POLICY, Asked, Costs, Status, Told
from torchds.sessions.tables import COSTS, State, failure, reference, reference_text, returned, write_table
from torchds.sessions.trial import Reference, Trial

BOOKS = ("asked", "given", "attempt", "spent", "failed")  # what a session keeps beside what it learns


class Books(ABC):
    """What a session has asked, told and spent, and how an update is made of it.

    The first roll-out of an update is the policy as it is. What it costs is the history of the session: the policy after the
    last update has no cost until it is tried.

    Args:
        folder: of the session.
        trial: what a roll-out is.
        policy: one, with a batch of one or none.
        optim: of its parameters, whose first roll-out is the policy itself (elite "nominal").
        n_updates: after which it ends.

    Attributes:
        asked: whether roll-outs were given out and have not been told.
        given: id of the references that were given out last; they and the state have it.
        attempt: of this update, from 1; another one follows where all roll-outs failed.
        spent: roll-outs so far.
        failed: how many of them failed since the last line of the history.
        best: the policy that cost least of those that were tried without noise, and what it cost; None before one has a
            finite cost.
    """

    says: type[Status] = Status
    """What `status` gives; its `hint` has the words for commands."""

    def __init__(self, folder: Path, trial: Trial, policy: GMRPolicy, optim: PolicySearch, n_updates: int) -> None:
        self.folder, self.trial, self.policy, self.optim, self.n_updates = folder, trial, policy, optim, n_updates
        self.asked, self.given, self.attempt, self.spent, self.failed = False, "", 1, 0, 0
        self.best: tuple[GMRPolicy, float] | None = None
        self._written = ""  # digest of the state as this object knows it

    @property
    @abstractmethod
    def history(self) -> Costs:
        """What the updates cost so far."""

    @abstractmethod
    def save(self) -> None:
        """Write everything, the state last: before that moment the command did not happen."""

    @abstractmethod
    def _step(self, closure: Callable[[], Tensor]) -> None:
        """One update, of a closure that returns the costs `(N, *batch)`."""

    @abstractmethod
    def _enter(self, terms: dict[str, Tensor], n_there: int) -> int:
        """Enter the cost terms `(N,)` of an update into the history; the number of its roll-outs that failed."""

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

    def _write(self, state: dict[str, Any]) -> None:
        """Replace the state by this, the best policy and the books."""
        best = None if self.best is None else {"policy": self.best[0].state_dict(), "cost": self.best[1]}
        state = {**state, "best": best, **{name: getattr(self, name) for name in BOOKS}}
        files.save(self.folder / STATE, "session", state)
        self._written = files.digest(state)

    def _read(self, state: dict[str, Any]) -> None:
        """Take the books from a state, and the best policy where it has one with a finite cost."""
        for name in BOOKS:
            setattr(self, name, state[name])
        if (best := state.get("best")) is not None and math.isfinite(best["cost"]):
            self.best = copy.deepcopy(self.policy), best["cost"]
            self.best[0].load_state_dict(best["policy"])
        self._written = files.digest(state)

    def hint(self, command: str) -> str:
        """What to type."""
        return self.says.hint(command, self.folder)

    @property
    def done(self) -> int:
        """Updates made so far."""
        return len(self.history.cost)

    @property
    def update_folder(self) -> Path:
        """Of the files of the update to come."""
        again = f".{self.attempt}" if self.attempt > 1 else ""
        return self.folder / f"update-{self.done + 1:03d}{again}"

    # ------------------------------------------------------------------ ask

    def ask(self) -> Asked:
        """Write the roll-outs of the next update, the same ones until they are told.

        A reference that the robot cannot reach is not written, and marked as failed.

        Raises:
            InvalidArgumentError: all updates are made.
            FileError: another process works on the session or has gone on with it, or other references are there.
        """
        with self.alone():
            return self._ask()

    def _ask(self) -> Asked:
        if self.done >= self.n_updates:
            raise InvalidArgumentError(f"{self.folder}: all {self.done} updates are made, there is nothing to ask")
        if not self.asked:
            self.optim.ask()
            noise = [self.optim.state[p]["noise"] for p in self.policy.parameters()]
            self.asked, self.given = True, files.digest([self.done, self.attempt, noise])[:16]
            self.save()
        asked = self.references()
        possible = self.trial.possible(asked)
        texts = {}
        for k in range(1, self.optim.n_rollouts + 1):
            if possible[k - 1]:
                text = self._text(Reference(*(part[k - 1] for part in asked)))
                texts[reference(self.update_folder, k).name] = text
            else:
                texts[failure(self.update_folder, k).name] = "the reference leaves what the arm reaches\n"
        give(self.update_folder, self.given, texts)
        out_of_reach = ((~possible).nonzero().flatten() + 1).tolist()
        again = [k for k in range(2, len(possible) + 1) if all(torch.equal(part[k - 1], part[0]) for part in asked)]
        return Asked(self.done + 1, self.n_updates, self.update_folder, self.optim.n_rollouts, out_of_reach, again)

    def _text(self, asked: Reference) -> str:
        return reference_text(self.trial.layout, asked.x, asked.v, asked.stiffness, self.trial.dt)

    def references(self) -> Reference:
        """What the roll-outs of this update have to follow, N in front of each field."""
        tried = copy.deepcopy(self.policy)
        for p, mine in zip(tried.parameters(), self.policy.parameters(), strict=True):
            p.data = mine.data + self.optim.state[mine]["noise"]
        asked = self.trial.reference(tried)
        return Reference(*(part.reshape(self.optim.n_rollouts, *part.shape[-2:]) for part in asked))

    # ------------------------------------------------------------------ tell

    def tell(self, missing: Literal["wait", "failed"] = "wait", force: bool = False) -> Told | None:
        """Make the update from what came back; None where nothing is asked, and nothing is changed.

        Args:
            missing: what a roll-out is that has not come back.
            force: take recordings that do not look like their references.

        Raises:
            InvalidArgumentError: roll-outs are missing, costs come where recordings came before or the other way round, or a
                cost term has a name that is not its own.
            FileError: a file that cannot be used, recordings that are not those of their references, or another process that
                works on the session or has gone on with it.
            AllRolloutsFailedError: no roll-out has a cost; the policy stays, and the session can ask again.
        """
        if missing not in ("wait", "failed"):
            raise InvalidArgumentError(f"missing has to be 'wait' or 'failed', got {missing!r}; nothing is changed")
        with self.alone():
            return self._tell(missing, force) if self.asked else None

    def _tell(self, missing: Literal["wait", "failed"], force: bool) -> Told:
        check_given(self.update_folder, self.given)
        states = returned(self.update_folder, self.optim.n_rollouts)
        if missing == "wait" and "missing" in states:
            status = self.status()
            raise InvalidArgumentError(f"{status.returned}; nothing is changed. {status.next}")
        evidence = self.evidence(states)
        findings = evidence.questions()
        if not force:
            refuse_gross(self.update_folder, findings, self.hint("insist"))
        seen: dict[str, Tensor] = {}

        def closure() -> Tensor:
            seen.update(evidence.terms(self.policy))
            return torch.stack(list(seen.values())).sum(0)

        tried = copy.deepcopy(self.policy)
        try:
            self._step(closure)
        except AllRolloutsFailedError as error:
            self.asked, self.attempt, self.failed = False, self.attempt + 1, self.failed + self.optim.n_rollouts
            self.spent += self.optim.n_rollouts
            self.save()
            raise AllRolloutsFailedError(
                f"all roll-outs failed; the policy stays as it is. {self.status().next}"
            ) from error
        terms = {name: values.flatten() for name, values in seen.items()}
        return self.finish(tried, terms, states, [str(f) for f in findings])

    def evidence(self, states: list[State]) -> Evidence:
        """What came back.

        Raises:
            InvalidArgumentError: costs where there were recordings before or the other way round: they do not compare.
            FileError: see `Evidence`.
        """
        evidence = Evidence(self.trial, self.update_folder, states, self.references())
        before = set(self.history.terms) - {"control"}
        if before and (before == {"measured"}) != (evidence.kind == "costs"):
            raise InvalidArgumentError(
                f"{self.update_folder}: a session is told recordings or {COSTS} all along; here are {evidence.kind} after "
                f"terms of {', '.join(sorted(before))}"
            )
        return evidence

    def finish(self, tried: GMRPolicy, terms: dict[str, Tensor], states: list[State], notes: list[str]) -> Told:
        """Enter the update into the books, from the policy before it and the cost terms `(N,)` of its roll-outs."""
        last = self.optim.last
        assert last is not None
        terms = {**terms, "control": last.control.flatten()}
        numbers = torch.stack([*terms.values(), last.cost.flatten(), last.weights.flatten()], -1).tolist()
        header = ["rollout", *terms, "cost", "weight", "state"]
        rows = [[k, *row, state] for k, (row, state) in enumerate(zip(numbers, states, strict=True), 1)]
        write_table(self.update_folder / "outcome.csv", header, rows)
        failed = self._enter(terms, states.count("there"))
        cost = self.history.cost[-1][0]
        if math.isfinite(cost) and (self.best is None or cost < self.best[1]):
            self.best = tried, cost
        self.spent += self.optim.n_rollouts
        self.failed, self.asked, self.attempt = failed, False, 1
        self.save()
        return Told(self.done, self.n_updates, self.failed, header, rows, notes)

    # ------------------------------------------------------------------ export

    def export(self, path: str | Path, **about: Any) -> GMRPolicy:
        """Write the best policy as a file for `torchds.Controller.load`, and return it.

        Args:
            path: of the file.
            **about: goal, P, names, units or dt, in place of what the policy, the layout and the trial say.

        Raises:
            InvalidArgumentError: no policy with a finite cost was tried yet, or none since an earlier version did not keep it.
        """
        if self.best is None:
            earlier = any(math.isfinite(cost) for (cost,) in self.history.cost)
            why = "was kept by the earlier version that tried them" if earlier else "was tried yet"
            last = f"the last one is in {self.folder / POLICY}"
            then = self.status().next if self.done < self.n_updates else last
            raise InvalidArgumentError(f"{self.folder}: no policy with a finite cost {why}; {then}")
        policy = self.best[0][0] if self.best[0].batch_shape else self.best[0]
        policy.save(path, **{**self._about(policy), **about})
        return policy

    def _about(self, policy: GMRPolicy) -> dict[str, Any]:
        """What a file of a policy says beside it: goal, P, names, units and dt, those that are known."""
        D = policy.input_dim
        names = tuple(name.partition(" [")[0] for name in self.trial.layout.position[:D])
        units = set(self.trial.layout.units[:D])
        return {"names": names, "units": units.pop() if len(units) == 1 else "", "dt": self.trial.dt}

    # ------------------------------------------------------------------ status

    def status(self) -> Status:
        """Where the session stands, what it has cost so far, and what comes next."""
        states = returned(self.update_folder, self.optim.n_rollouts) if self.asked else None
        return self.says(self.folder, self.done, self.n_updates, self.spent, self.history, self.update_folder, states)
