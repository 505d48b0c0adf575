"""What a roll-out of digging is to a session: the reference of the task, and its cost terms from what the robot measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torch import Tensor

from tasks.digging import lwr
from tasks.digging.simulation import WEIGHING
from tasks.digging.simulation import Recording as Measured
from tasks.digging.task import LwrDigging
from torchds import GMRPolicy, sessions
from torchds.sessions.questions import Finding
from torchds.sessions.tables import Recorded
from torchds.sessions.trial import Reference
from train.hardware import robot_files
from train.hardware.questions import question


class Trial(sessions.Trial):
    """One pass of the shovel."""

    def __init__(self, task: LwrDigging) -> None:
        super().__init__(task.start, task.motion().n_steps, task.dt, robot_files.LAYOUT)
        self.task = task

    def reference(self, policy: GMRPolicy) -> Reference:
        """Poses, their rates, and the stiffness within its bounds."""
        path, poses, stiffness = self.task.reference(policy)
        return Reference(poses, path.v, stiffness.unsqueeze(-1))

    def possible(self, asked: Reference) -> Tensor:
        """Whether the arm of the simulation reaches all poses."""
        return lwr.reaches(*asked.x.unbind(-1)).all(-1) & asked.stiffness.isfinite().flatten(-2).all(-1)

    def terms(self, policy: GMRPolicy, recorded: Recorded, there: Tensor) -> dict[str, Tensor]:
        """Cost terms `(N, 1)` of the roll-outs, while the policy carries their noise."""
        path, _, stiffness = self.task.reference(policy)  # reports what it visits, for the control cost
        pose, force = (field.unsqueeze(1) for field in recorded)
        load = force[..., -round(WEIGHING / self.task.dt) :, 2].mean(-1)
        unused = pose.new_zeros(0)
        plant = Measured(pose, force, unused, stiffness, load, unused, ~there.unsqueeze(-1))
        return self.task.cost_terms(replace(path, x=pose, v=pose.diff(dim=-2) / self.task.dt, plant=plant))

    def question(self, numbers: Sequence[int], recorded: Recorded, asked: Reference) -> list[Finding]:
        """Whether the recordings are those of their references, and their forces of this arm."""
        measured = robot_files.Recorded(*recorded)
        return question(numbers, measured, asked.x, asked.stiffness[..., 0], self.task.dt)
