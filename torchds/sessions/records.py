"""What a session says: records of what was asked, told and spent, and the words for the terminal.

Stability: experimental.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from torchds.sessions.tables import COSTS, State

POLICY = "policy.pt"


class Costs(Protocol):
    """What a status tells of a history: lines of one number each."""

    cost: list[list[float]]
    terms: dict[str, list[list[float]]]
    failed: list[int]


@dataclass
class History:
    """What each update has cost, of the policy as it was tried before it.

    Attributes:
        rollouts: `[U]` spent before.
        cost: `[U][1]`.
        terms: name -> `[U][1]`.
        failed: `[U]` roll-outs that failed since the update before.
        seconds: that the robot moved.
    """

    rollouts: list[int] = field(default_factory=list)
    cost: list[list[float]] = field(default_factory=list)
    terms: dict[str, list[list[float]]] = field(default_factory=dict)
    failed: list[int] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, rollouts: int, terms: dict[str, float], failed: int) -> None:
        """Append an update; a term that it or those before do not have is NaN there."""
        self.rollouts.append(rollouts)
        self.cost.append([sum(terms.values())])
        for name in {**self.terms, **terms}:
            self.terms.setdefault(name, [[math.nan] for _ in self.cost[1:]]).append([terms.get(name, math.nan)])
        self.failed.append(failed)


class Asked(NamedTuple):
    """The roll-outs of an update, written for the robot.

    Attributes:
        update: its number, from 1.
        n_updates: of the session.
        folder: of the references.
        n_rollouts: N; the first is the policy as it is, the others are perturbed.
        out_of_reach: numbers of the roll-outs that the arm cannot execute; they count as failed.
        again: numbers of those that are the first once more, by which a search finds out how noisy costs are.
    """

    update: int
    n_updates: int
    folder: Path
    n_rollouts: int
    out_of_reach: list[int]
    again: list[int] = []  # noqa: RUF012 (a default of a named tuple, which nobody changes)

    def __str__(self) -> str:
        lines = [
            f"update {self.update} of {self.n_updates}, references in {self.folder}: rollout-1.csv is the policy as it is, "
            f"2 to {self.n_rollouts} are perturbed",
            *(f"roll-out {k} is the first once more: execute both, their costs tell the noise" for k in self.again),
            *(f"do not execute roll-out {k}: out of reach" for k in self.out_of_reach),
        ]
        return "\n".join(lines)


class Told(NamedTuple):
    """An update, made from what came back.

    Attributes:
        update: its number, from 1.
        n_updates: of the session.
        failed: roll-outs that failed.
        header: names of the columns of `rows`: the roll-out, its cost terms, cost, weight and state.
        rows: one for each roll-out.
        notes: what is odd about the recordings.
    """

    update: int
    n_updates: int
    failed: int
    header: list[str]
    rows: list[list[int | float | str]]
    notes: list[str] = []  # noqa: RUF012 (a default of a named tuple, which nobody changes)

    def __str__(self) -> str:
        bad = f", {self.failed} failed" if self.failed else ""
        made = f"update {self.update} of {self.n_updates} is made from {len(self.rows)} roll-outs{bad}"
        return "\n".join([made, *(f"note: {note}" for note in self.notes), aligned(self.header, self.rows)])


class Status(NamedTuple):
    """Where a session stands.

    Attributes:
        folder: of the session.
        done: updates made so far.
        n_updates: of the session.
        spent: roll-outs so far.
        history: what the policy cost as it was tried, before each update.
        update_folder: of the files of the update to come.
        states: what has come back of the roll-outs that were asked; None where nothing is asked.
    """

    folder: Path
    done: int
    n_updates: int
    spent: int
    history: Costs
    update_folder: Path
    states: list[State] | None

    def __str__(self) -> str:
        lines = [f"{self.folder}: {self.done} of {self.n_updates} updates made, {self.spent} roll-outs spent"]
        if self.history.cost:
            header = ["after update", *self.history.terms, "cost", "failed before"]
            columns = [[row[0] for row in rows] for rows in (*self.history.terms.values(), self.history.cost)]
            rows = list(zip(range(self.done), *columns, self.history.failed, strict=True))
            lines += ["cost of the policy as it was tried:", aligned(header, rows)]
        if self.states is not None:
            lines.append(self.returned)
        return "\n".join([*lines, self.next])

    @property
    def returned(self) -> str:
        """What has come back of the roll-outs that were asked, in words."""
        states = self.states or []
        found = {kind: [str(k) for k, state in enumerate(states, 1) if state == kind] for kind in dict.fromkeys(states)}
        parts = [f"{', '.join(numbers)} {kind}" for kind, numbers in found.items()]
        return f"update {self.done + 1}, roll-outs in {self.update_folder}: {'; '.join(parts)}"

    @property
    def next(self) -> str:
        """The command to type next, in words."""
        if self.states is None:
            if self.done < self.n_updates:
                return f"next: {self.hint('ask', self.folder)}"
            last = f"the last policy, not tried yet, is in {self.folder / POLICY}"
            return f"all updates are made; the best that was tried: {self.hint('export', self.folder)}; {last}"
        first = ""
        if "missing" in self.states:
            first = f"put recording-<k>.csv, or recording-<k>.failed, or one {COSTS} beside the references, then "
        return f"next: {first}{self.hint('tell', self.folder)}"

    @staticmethod
    def hint(command: str, folder: Path) -> str:
        """What to type for "ask", "tell", "status", "export" or "insist", which is to tell all the same."""
        given = {"insist": "session.tell(force=True)", "export": "session.export('best.pt')"}
        return given.get(command, f"session.{command}()")


def aligned(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table for the terminal: numbers to the right and with four digits, text to the left.

    Args:
        header: names of the columns.
        rows: one cell for each column. A column whose cells are all numbers is set to the right.
    """
    texts = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    columns = []
    for i, name in enumerate(header):
        column = [name, *(row[i] for row in texts)]
        width = max(map(len, column))
        numbers = rows and all(isinstance(row[i], int | float) for row in rows)
        columns.append([cell.rjust(width) if numbers else cell.ljust(width) for cell in column])
    return "\n".join("  ".join(line).rstrip() for line in zip(*columns, strict=True))
