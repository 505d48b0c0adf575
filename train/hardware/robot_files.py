"""The files between a learning session and a robot: references to execute, and the recordings or costs that come back.

Tables are comma-separated under a header of names with units; numbers keep all their digits. Letters: `N` roll-outs, `T`
control steps. docs/hardware.md is the page for whoever writes or reads them on the robot's side.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from scipy.interpolate import make_interp_spline
from torch import Tensor

from torchds.errors import FileError
from torchds.recordings import read_table
from train.folder import write_atomically

POSE = ("x [m]", "z [m]", "angle [rad]")
REFERENCE = ("time [s]", *POSE, "v_x [m/s]", "v_z [m/s]", "v_angle [rad/s]", "stiffness [N/m]")
FORCE = ("force_x [N]", "force_y [N]", "force_z [N]")
OPTIONAL = "force_y [N]"
COSTS = "costs.csv"

MAX_GAP = 0.1
"""Longest time between two samples of a recording [s]; more is a recorder that dropped out."""
START = (0.05, 0.05, 0.2)
"""How far from the first point of the reference a recording may start: x [m], z [m], angle [rad]."""

State = Literal["there", "failed", "missing"]


class Recorded(NamedTuple):
    """What was measured along one motion, at the control steps.

    Attributes:
        pose: `(T+1, 3)` of the tool: x [m], z [m], angle [rad].
        force: `(T, 3)` between gripper and shovel at the ends of the steps, less the empty shovel's weight [N].
    """

    pose: Tensor
    force: Tensor


def control_times(n_steps: int, dt: float) -> np.ndarray:
    """The T+1 times of the control steps [s], without digits that come from binary fractions alone."""
    return np.round(np.arange(n_steps + 1) * dt, 9)


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Write a table atomically; floats are read back bit for bit."""
    lines = [",".join(header), *(",".join(map(str, row)) for row in rows)]
    write_atomically(path, lambda temporary: temporary.write_text("\n".join(lines) + "\n"))


def write_reference(path: Path, pose: Tensor, v: Tensor, stiffness: Tensor, dt: float) -> None:
    """Write what a robot has to follow, T+1 rows; velocity and stiffness hold from their row to the next.

    Args:
        path: the file.
        pose: `(T+1, 3)` x [m], z [m], angle [rad].
        v: `(T, 3)` its velocity [m/s, m/s, rad/s]; the last row says zero.
        stiffness: `(T,)` [N/m]; the last row says the last again.
        dt: time step [s].
    """
    t = torch.from_numpy(control_times(len(stiffness), dt)).unsqueeze(-1)
    at_rest, held = torch.cat([v, torch.zeros_like(v[:1])]), torch.cat([stiffness, stiffness[-1:]]).unsqueeze(-1)
    write_table(path, REFERENCE, torch.cat([t, pose, at_rest, held], -1).tolist())


def read_recording(path: Path, start: Tensor, n_steps: int, dt: float) -> Recorded:
    """Read what a robot measured, at any rate, and bring it to the control steps.

    Poses go through a cubic spline, since their second differences count, forces through straight lines. A recording at
    the control steps themselves is taken as it is.

    Args:
        path: a table with the columns time, pose and force, others are ignored; `OPTIONAL` is zero where it is not there.
        start: `(3,)` the first pose of the reference.
        n_steps: T.
        dt: time step [s].

    Raises:
        FileError: a file that is no table of finite numbers, columns that are not there or have another unit,
            times that do not increase, leave a gap, or do not cover the motion, or a start elsewhere.
    """
    header, table = read_table(path)
    needed = ("time [s]", *POSE, *FORCE)
    if absent := [name for name in needed if name not in header and name != OPTIONAL]:
        raise FileError(
            f"{path}: no column {', '.join(map(repr, absent))}. The columns have to be {', '.join(needed)} ({OPTIONAL} may be "
            f"left out), units included; the header says {', '.join(header)}."
        )
    columns = dict(zip(header, table.T, strict=True))
    columns.setdefault(OPTIONAL, np.zeros(len(table)))
    t, times = columns["time [s]"], control_times(n_steps, dt)
    check_times(path, t, times)
    pose, force = (np.stack([columns[name] for name in names], -1) for names in (POSE, FORCE))
    for name, measured, wanted, allowed in zip(POSE, pose[0], start.tolist(), START, strict=True):
        if abs(measured - wanted) > allowed:
            raise FileError(
                f"{path}: the motion starts at {name} = {measured:g}, its reference at {wanted:g}. They have to agree within "
                f"{allowed:g}: same base frame, tool point and units."
            )
    return Recorded(
        torch.from_numpy(resample(t, pose, times, degree=3)),
        torch.from_numpy(resample(t, force, times, degree=1)[1:]),
    )


def read_recordings(folder: Path, states: Sequence[State], start: Tensor, n_steps: int, dt: float) -> Recorded:
    """Read the recordings that are there; the robot stands still in those that are not.

    Args:
        folder: of the update.
        states: `[N]` what has come back, see `returned`.
        start: `(3,)` the first pose of the reference.
        n_steps: T.
        dt: time step [s].

    Returns:
        Poses `(N, T+1, 3)` and forces `(N, T, 3)`.

    Raises:
        FileError: see `read_recording`.
    """
    still = Recorded(start.expand(n_steps + 1, 3), start.new_zeros(n_steps, 3))
    recordings = [
        read_recording(recording(folder, k), start, n_steps, dt) if state == "there" else still
        for k, state in enumerate(states, 1)
    ]
    return Recorded(*(torch.stack(field) for field in zip(*recordings, strict=True)))


def check_times(path: Path, t: np.ndarray, times: np.ndarray) -> None:
    """Refuse sample times `t` that do not cover the motion at `times`.

    Raises:
        FileError: what is wrong with them.
    """
    steps = np.diff(t)
    if steps.min() <= 0:
        at = int(steps.argmin()) + 1
        raise FileError(f"{path}: the time has to increase, but {t[at]:g} s follows {t[at - 1]:g} s.")
    if steps.max() > MAX_GAP:
        at = int(steps.argmax())
        raise FileError(
            f"{path}: nothing between {t[at]:g} and {t[at + 1]:g} s. Samples have to be at most {MAX_GAP:g} s apart."
        )
    slack = max(np.median(steps), times[1]) + 1e-9
    if abs(t[0]) > slack or abs(t[-1] - times[-1]) > slack:
        raise FileError(
            f"{path}: lasts from {t[0]:g} to {t[-1]:g} s, the motion from 0 to {times[-1]:g} s. They have to agree within one "
            "sample: cut the recording, or mark the roll-out as failed if the robot stopped."
        )


def resample(t: np.ndarray, values: np.ndarray, times: np.ndarray, degree: int) -> np.ndarray:
    """Values `(samples, D)` at other times, by a spline through all of them; held before the first and after the last."""
    if np.array_equal(t, times):
        return values
    return make_interp_spline(t, values, degree)(times.clip(t[0], t[-1]))


def read_costs(path: Path, n: int) -> dict[int, float]:
    """Read a table with the columns rollout and cost: infinity where the cost is empty or says "failed".

    Raises:
        FileError: another header, or a line that names no roll-out from 1 to n, names one again, or has no
            finite cost.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        header, *lines = [[cell.strip() for cell in line] for line in csv.reader(file) if line] or [[]]
    if header != ["rollout", "cost"]:
        raise FileError(f"{path}: the header has to be rollout,cost, it is {','.join(header)!r}.")
    costs: dict[int, float] = {}
    for line in lines:
        try:
            rollout, cost = int(line[0]), math.inf if line[1] in ("", "failed") else float(line[1])
            usable = len(line) == 2 and 1 <= rollout <= n and rollout not in costs
            usable = usable and (math.isfinite(cost) or line[1] in ("", "failed"))
        except (ValueError, IndexError):
            usable = False
        if not usable:
            raise FileError(
                f"{path}: {','.join(line)!r} is no line like 3,1.25 or 3,failed with a roll-out from 1 to {n}, each once."
            )
        costs[rollout] = cost
    return costs


def returned(folder: Path, n: int) -> list[State]:
    """What has come back of the roll-outs 1 to n; a mark recording-<k>.failed counts more than a recording beside it.

    Raises:
        FileError: recordings and costs both, or costs that cannot be read.
    """
    costs = read_costs(folder / COSTS, n) if (folder / COSTS).is_file() else {}
    states: list[State] = []
    for k in range(1, n + 1):
        recorded = recording(folder, k).is_file()
        if recorded and (folder / COSTS).is_file():
            raise FileError(f"{folder}: has recordings and {COSTS}. Leave one of them.")
        failed = failure(folder, k).exists() or math.isinf(costs.get(k, 0.0))
        states.append("failed" if failed else "there" if recorded or k in costs else "missing")
    return states


def reference(folder: Path, k: int) -> Path:
    """What roll-out k has to follow."""
    return folder / f"rollout-{k}.csv"


def recording(folder: Path, k: int) -> Path:
    """The recording of roll-out k."""
    return folder / f"recording-{k}.csv"


def failure(folder: Path, k: int) -> Path:
    """The mark of a roll-out that failed, whatever it holds."""
    return folder / f"recording-{k}.failed"
