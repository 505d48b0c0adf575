"""What came back of the roll-outs of an update: recordings or costs, read once, and what they cost.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torchds.errors import FileError
from torchds.policy import GMRPolicy
from torchds.sessions.layout import Layout
from torchds.sessions.questions import Finding, clocks
from torchds.sessions.tables import COSTS, Recorded, State, check_settled, read_costs, read_recordings, recording
from torchds.sessions.trial import Reference, Trial


class Evidence:
    """Recordings or costs of an update.

    Args:
        trial: what a roll-out is.
        folder: of the update.
        states: `[N]` what has come back, see `torchds.sessions.tables.returned`.
        asked: of the roll-outs, N in front of each field.

    Attributes:
        costs: `(N,)` that were given; None where there are recordings.
        recorded: what was measured, N in front, where there are recordings.
        kind: "costs" or "recordings".

    Raises:
        FileError: a file that cannot be used, or that somebody is writing.
    """

    def __init__(self, trial: Trial, folder: Path, states: Sequence[State], asked: Reference) -> None:
        self.trial, self.folder, self.states, self.asked = trial, folder, states, asked
        self.there = torch.tensor([state == "there" for state in states])
        costs = folder / COSTS
        come = [costs] if costs.is_file() else [recording(folder, k) for k in self.numbers]
        check_settled(come)
        self.costs: Tensor | None = None
        if costs.is_file():
            given = read_costs(costs, len(states))
            values = [given[k] if state == "there" else torch.inf for k, state in enumerate(states, 1)]
            self.costs = torch.tensor(values, dtype=asked.x.dtype)
        else:
            layout = trial.layout
            if not layout.start:  # what was not asked for has no size
                moved = asked.x.where(trial.possible(asked)[:, None, None], asked.x[:, :1])
                layout = replace(layout, start=near(layout, moved))
            read = read_recordings(layout, folder, states, asked.x[:, 0], trial.n_steps, trial.dt)
            self.recorded = Recorded(*(part.to(asked.x) for part in read))
        check_settled(come)

    @property
    def kind(self) -> str:
        """Which of the two it is."""
        return "recordings" if self.costs is None else "costs"

    @property
    def numbers(self) -> list[int]:
        """Of the roll-outs that are there."""
        return [k for k, state in enumerate(self.states, 1) if state == "there"]

    def terms(self, policy: GMRPolicy) -> dict[str, Tensor]:
        """Cost terms `(N, *batch)` of the roll-outs, while the policy carries their noise."""
        if self.costs is None:
            return self.trial.terms(policy, self.recorded, self.there)
        self.trial.reference(policy)  # reports what it visits, for the control cost
        return {"measured": self.costs.reshape(-1, *[1] * (len(policy.batch_shape) - 1))}

    def questions(self) -> list[Finding]:
        """What is to be said about the recordings."""
        if self.costs is not None or not self.numbers:
            return []
        i = torch.tensor(self.numbers) - 1
        recorded = Recorded(*(field[i] for field in self.recorded))
        found = self.trial.question(self.numbers, recorded, Reference(*(field[i] for field in self.asked)))
        return [*found, *clocks(self.trial.layout, self.numbers, self.folder)]


def refuse_gross(folder: Path, findings: Sequence[Finding], insist: str) -> None:
    """Refuse recordings that are not those of their references.

    Raises:
        FileError: what was found, and the command that insists.
    """
    if gross := [finding for finding in findings if finding.gross]:
        raise FileError(
            f"{folder}: {'; '.join(map(str, gross))}. Nothing is changed; record again, mark roll-outs as failed, or insist: "
            f"{insist}"
        )


def near(layout: Layout, x: Tensor) -> tuple[float, ...]:
    """A tenth of how far the references `(N, T+1, C)` go, in the columns of one unit together."""
    extent = (x.flatten(0, -2).amax(0) - x.flatten(0, -2).amin(0)).tolist()
    size = {
        unit: max(e for e, other in zip(extent, layout.units, strict=True) if other == unit) for unit in layout.units
    }
    return tuple(max(0.1 * size[unit], 1e-9) for unit in layout.units)
