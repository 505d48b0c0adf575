"""Trials for the page: of the digging, of an arm, and of motions in space or in the plane."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tasks.base import Task
from torchds import GMRPolicy, Rollout
from train.view.page import Take

MOMENTS = 200  # at most, along a motion


@torch.no_grad()
def of_digging(task: Any, policies: Mapping[str, GMRPolicy], trials: int) -> list[Take]:
    """Trials of digging policies, each trial on the same bed for all of them.

    Args:
        task: `tasks.digging.task.LwrDigging`.
        policies: by what they are called.
        trials: of each.
    """
    from tasks.digging.simulation import SNAPSHOT

    begun, takes = task.trials, []
    for name, policy in policies.items():
        task.trials = begun
        path = task.rollout(policy.expand(trials))
        done, force = path.plant, task.force(path.plant).norm(dim=-1)
        between = round(SNAPSHOT / task.dt)
        for i in range(trials):
            frames = done.snapshots[i].numpy().astype(float)
            every = np.arange(len(frames)) * between
            steps = np.minimum(every, force.shape[-1] - 1)
            reference, tool = (_lifted(x[i, every, :2]) for x in (path.reference, done.pose))
            series = {"force [N]": force[i].numpy()[steps], "stiffness [N/m]": done.stiffness[i].numpy()[steps]}
            series["height of the blade [m]"] = done.pose[i, every, 1].numpy()
            load = f"trial {i + 1}"
            takes.append(
                Take(
                    name,
                    load,
                    SNAPSHOT * np.arange(len(frames)),
                    frames,
                    {"reference": reference, "tool": tool},
                    series,
                )
            )
    return takes


def of_arm(times: np.ndarray, qpos: np.ndarray, tool: np.ndarray, wanted: np.ndarray) -> list[Take]:
    """A motion that an arm followed.

    Args:
        times: `(F,)` [s].
        qpos: `(F, nq)` generalised positions of its model.
        tool: `(F, 3)` where the tool was [m].
        wanted: `(F, 3)` where it should have been [m].
    """
    behind = {"behind the reference [mm]": 1e3 * np.linalg.norm(wanted - tool, axis=-1)}
    return [Take("impedance control", "1", times, qpos, {"reference": wanted, "tool": tool}, behind)]


@torch.no_grad()
def of_motion(task: Task, policies: Mapping[str, GMRPolicy]) -> list[Take]:
    """The motions of policies of any task, from each of its starts; those in a plane lie on the floor.

    Where a plant tracks them, what it did is the motion, beside its reference.
    """
    dt, takes = task.motion().dt, []
    for name, policy in policies.items():
        path: Rollout = task.rollout(policy)
        tracks = {"motion": path.x} if path.plant is None else {"reference": path.reference, "motion": path.x}
        motions = {what: _single(x) for what, x in tracks.items()}
        speed = _single(path.v).norm(dim=-1)
        every = torch.linspace(0, speed.shape[-1], min(MOMENTS, speed.shape[-1] + 1)).round().long()
        steps = every.clamp(max=speed.shape[-1] - 1)
        for i in range(len(speed)):
            paths = {what: _flat(x[i, every]) for what, x in motions.items()}
            takes.append(
                Take(name, f"start {i + 1}", dt * every.numpy(), None, paths, {"speed": speed[i, steps].numpy()})
            )
    return takes


def _single(x: Tensor) -> Tensor:
    """`(M, T+1, D)` of motions `(*batch, T+1, D)`."""
    return x.detach().reshape(-1, *x.shape[-2:])


def _flat(x: Tensor) -> np.ndarray:
    """`(F, 3)` of points `(F, D)`: their first three, or in the plane z = 0."""
    missing = max(0, 3 - x.shape[-1])
    return np.pad(x[..., :3].numpy(), [(0, 0), (0, missing)])


def _lifted(x: Tensor) -> np.ndarray:
    """`(F, 3)` of points `(F, 2)`, x and z, in front of the grains."""
    return np.stack([x[:, 0].numpy(), np.full(len(x), -0.07), x[:, 1].numpy()], -1)
