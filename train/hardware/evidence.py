"""What came back of the roll-outs of an update: recordings or costs, read once, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from tasks.digging.simulation import WEIGHING
from tasks.digging.simulation import Recording as Trial
from tasks.digging.task import LwrDigging
from torchds import GMRPolicy
from torchds.errors import FileError
from train.hardware.questions import Finding, question
from train.hardware.robot_files import (
    COSTS,
    Recorded,
    State,
    check_settled,
    read_costs,
    read_recordings,
    recording,
)


class Evidence:
    """Recordings or costs of an update.

    Args:
        task: that the robot does.
        folder: of the update.
        states: `[N]` what has come back, see `train.hardware.robot_files.returned`.

    Attributes:
        names: of the cost terms; the control cost is not among them.

    Raises:
        FileError: a file that cannot be used, or that somebody is writing.
    """

    def __init__(self, task: LwrDigging, folder: Path, states: Sequence[State]) -> None:
        self.task, self.folder, self.states = task, folder, states
        self.there = torch.tensor([state == "there" for state in states])
        costs = folder / COSTS
        come = [costs] if costs.is_file() else [recording(folder, k) for k in self.numbers]
        check_settled(come)
        self.costs: Tensor | None = None
        if costs.is_file():
            given = read_costs(costs, len(states))
            values = [given[k] if state == "there" else torch.inf for k, state in enumerate(states, 1)]
            self.costs = torch.tensor(values, dtype=task.start.dtype).unsqueeze(-1)
            self.names = {"measured"}
        else:
            self.recorded = read_recordings(folder, states, task.start, task.motion().n_steps, task.dt)
            self.names = {"gravel", "goal", "force", "stiffness", "acceleration"}
        check_settled(come)

    @property
    def numbers(self) -> list[int]:
        """Of the roll-outs that are there."""
        return [k for k, state in enumerate(self.states, 1) if state == "there"]

    def terms(self, policy: GMRPolicy) -> dict[str, Tensor]:
        """Cost terms `(N, 1)` of the roll-outs, while the policy carries their noise."""
        path, _, stiffness = self.task.reference(policy)  # reports what it visits, for the control cost
        if self.costs is not None:
            return {"measured": self.costs}
        pose, force = (field.unsqueeze(1) for field in self.recorded)
        load = force[..., -round(WEIGHING / self.task.dt) :, 2].mean(-1)
        unused = pose.new_zeros(0)
        plant = Trial(pose, force, unused, stiffness, load, unused, ~self.there.unsqueeze(-1))
        return self.task.cost_terms(replace(path, x=pose, v=pose.diff(dim=-2) / self.task.dt, plant=plant))

    def questions(self, poses: Tensor, stiffness: Tensor) -> list[Finding]:
        """What is to be said about the recordings.

        Args:
            poses: `(N, T+1, 3)` of the references.
            stiffness: `(N, T)` of the references [N/m].
        """
        if self.costs is not None or not self.numbers:
            return []
        i = torch.tensor(self.numbers) - 1
        recorded = Recorded(*(field[i] for field in self.recorded))
        return question(self.numbers, recorded, poses[i], stiffness[i], self.task.dt, self.folder)


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
