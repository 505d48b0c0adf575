"""The files between a digging session and a robot: the columns of `torchds.sessions.tables` for the arm's plane."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from torch import Tensor

from torchds.sessions import Layout, tables
from torchds.sessions.tables import COSTS as COSTS
from torchds.sessions.tables import State as State
from torchds.sessions.tables import control_times as control_times
from torchds.sessions.tables import failure as failure
from torchds.sessions.tables import read_costs as read_costs
from torchds.sessions.tables import recording as recording
from torchds.sessions.tables import reference as reference
from torchds.sessions.tables import returned as returned

LAYOUT = Layout(
    position=("x [m]", "z [m]", "angle [rad]"),
    velocity=("v_x [m/s]", "v_z [m/s]", "v_angle [rad/s]"),
    stiffness=("stiffness [N/m]",),
    measured=("force_x [N]", "force_y [N]", "force_z [N]"),
    optional=("force_y [N]",),
    start=(0.05, 0.05, 0.2),
    lever=(1.0, 1.0, 0.2),
)


class Recorded(NamedTuple):
    """What was measured along one motion, at the control steps.

    Attributes:
        pose: `(T+1, 3)` of the tool: x [m], z [m], angle [rad].
        force: `(T, 3)` between gripper and shovel at the ends of the steps, less the empty shovel's weight [N].
    """

    pose: Tensor
    force: Tensor


def reference_text(pose: Tensor, v: Tensor, stiffness: Tensor, dt: float) -> str:
    """What a robot has to follow: poses `(T+1, 3)`, velocities `(T, 3)` and stiffness `(T,)`, every `dt` [s]."""
    return tables.reference_text(LAYOUT, pose, v, stiffness.unsqueeze(-1), dt)


def read_recording(path: Path, start: Tensor, n_steps: int, dt: float) -> Recorded:
    """What a robot measured, see `torchds.sessions.tables.read_recording`."""
    return Recorded(*tables.read_recording(LAYOUT, path, start, n_steps, dt))


def read_recordings(folder: Path, states: Sequence[State], start: Tensor, n_steps: int, dt: float) -> Recorded:
    """All that a robot measured in an update, see `torchds.sessions.tables.read_recordings`."""
    return Recorded(*tables.read_recordings(LAYOUT, folder, states, start, n_steps, dt))


def clock_jump(t: np.ndarray, pose: np.ndarray) -> str:
    """A jump of the clock in words, see `torchds.sessions.tables.clock_jump`."""
    return tables.clock_jump(t, pose, LAYOUT.lever)
