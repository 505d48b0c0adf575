"""Digging roll-outs: the arm follows references under Cartesian impedance control, all of a batch at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.interpolate
import torch
from torch import Tensor

from tasks.digging import lwr
from tasks.digging.worlds import GRAVITY, Worlds
from torchds.cartesian import CartesianImpedance
from torchds.errors import InvalidArgumentError
from torchds.targets import PlaneReference

WEIGHING = 0.5
"""Length of the mean over the end of a roll-out that weighs the load [s]."""
SNAPSHOT = 0.1
"""Time between two snapshots of the whole world [s]."""


class Recording(NamedTuple):
    """What was measured along a batch of roll-outs.

    Attributes:
        pose: `(N, T+1, 3)` of the tool: x [m], z [m], angle [rad].
        force: `(N, T, 3)` between gripper and shovel less the weight of the empty shovel, base frame [N]: what the arm does
            to the gravel, and to the shovel's inertia.
        torque: `(N, T, J)` of the joints [N m].
        stiffness: `(N, T)` [N/m].
        load: `(N,)` weight of the gravel on the shovel at the end [N].
        snapshots: `(N, F, nq)` generalised positions of arm and grains, the start first, then every `SNAPSHOT`, in single
            precision: enough for pictures.
        failed: `(N,)` True where the simulation exploded or lost a grain; nothing else of such a roll-out counts.
    """

    pose: Tensor
    force: Tensor
    torque: Tensor
    stiffness: Tensor
    load: Tensor
    snapshots: Tensor
    failed: Tensor


# t [share of the motion], x [m], z [m], angle [rad]: along the blade into the gravel, then turn, lift and hold with the tip
# up, since a level blade leaks.
WAY_POINTS = np.array(
    [
        (0.0, 0.590, 0.235, -0.65),
        (2.5 / 15, 0.620, 0.165, -0.65),
        (7.0 / 15, 0.735, 0.050, -0.60),
        (9.5 / 15, 0.775, 0.060, -0.02),
        (11.5 / 15, 0.785, 0.120, 0.22),
        (14.0 / 15, 0.785, 0.260, 0.28),
        (1.0, 0.785, 0.260, 0.28),
    ]
)


def scoop(seconds: float = 15.0, dt: float = 0.004, way_points: np.ndarray = WAY_POINTS) -> Tensor:
    """A hand-made digging motion `(T+1, 3)`: x [m], z [m], angle [rad], by monotone cubics through way points.

    With it the lag F/s behind the reference decides how deep the blade goes, and so how much it loads.

    Args:
        seconds: its duration.
        dt: time step [s].
        way_points: `(L, 4)` t [share of the motion], x [m], z [m], angle [rad].
    """
    t, *points = way_points.T
    times = np.arange(round(seconds / dt) + 1) * dt / seconds
    return torch.from_numpy(scipy.interpolate.PchipInterpolator(t, np.stack(points, -1))(times.clip(max=1.0)))


class Trials:
    """All arms of `worlds` follow references from rest, step by step.

    Args:
        worlds: N copies of the world.
        start: `(N, 3)` x [m], z [m], angle [rad].
        seeds: of the beds, one a roll-out.

    Raises:
        InvalidArgumentError: a start out of reach.
    """

    def __init__(self, worlds: Worlds, start: Tensor, seeds: list[int]) -> None:
        self.worlds, self.dt = worlds, worlds.gravel.time_step
        q = lwr.posture(*start.unbind(-1))
        # The free joint swivels the elbow out of the plane; any posture in the plane keeps it there.
        # Compiled where numba is, which the extra "digging" brings: gravel is chaotic, and without it moves otherwise.
        self.control = CartesianImpedance(lwr.chain(), q[0], torque_limit=lwr.EFFORTS)
        worlds.reset(q, seeds)
        self.poses: list[Tensor] = [start]
        self.readings: list[tuple[np.ndarray, np.ndarray]] = []
        self.torques: list[Tensor] = []
        self.stiffness: list[Tensor] = []
        self.snapshots = [worlds.snapshot()]
        self._between = round(SNAPSHOT / self.dt)

    def step(self, point: Tensor, rate: Tensor, s: Tensor) -> None:
        """One time step towards `point` `(N, 3)` at `rate` `(N, 3)`, with stiffness `s` `(N,)` [N/m]."""
        worlds, began = self.worlds, time.perf_counter()
        # A roll-out that explodes must not take the others with it; it is marked at the end.
        q, v = worlds.q.nan_to_num(0.0, 0.0, 0.0), worlds.v.nan_to_num(0.0, 0.0, 0.0)
        wanted = PlaneReference(point[:, :2], point[:, 2], rate[:, :2], rate[:, 2])
        asked = self.control(q, v, worlds.mass, worlds.bias, wanted, s)
        if self.torques:
            self.poses.append(_in_plane(self.control, asked.pose))
        self.torques.append(asked.torque)
        self.stiffness.append(s)
        decided = time.perf_counter()
        worlds.step(asked.torque)
        stepped = time.perf_counter()
        self.readings.append(worlds.reading)
        if len(self.torques) % self._between == 0:
            self.snapshots.append(worlds.snapshot())
        worlds.seconds["physics"] += stepped - decided
        worlds.seconds["control"] += decided - began + time.perf_counter() - stepped

    def recording(self) -> Recording:
        """What was measured so far, after a step at least."""
        worlds = self.worlds
        _, last = self.control.chain.jacobian(worlds.q.nan_to_num(0.0, 0.0, 0.0), ret_eef_pose=True)
        force = worlds.force(*(np.stack(part, 1) for part in zip(*self.readings, strict=True)))
        force[..., 2] -= lwr.SHOVEL_MASS * GRAVITY
        return Recording(
            pose=torch.stack([*self.poses, _in_plane(self.control, last)], 1),
            force=force,
            torque=torch.stack(self.torques, 1),
            stiffness=torch.stack(self.stiffness, 1),
            load=force[:, -max(1, round(WEIGHING / self.dt)) :, 2].mean(-1),
            snapshots=torch.stack(self.snapshots, 1),
            failed=worlds.failed,
        )


def dig(
    worlds: Worlds,
    reference: Tensor,
    stiffness: Tensor,
    seeds: list[int],
    progress: Callable[[float], object] | None = None,
) -> Recording:
    """Let all arms of `worlds` follow their references from rest at the first point.

    Args:
        worlds: N copies of the world.
        reference: `(T+1, 3)` or `(N, T+1, 3)`, one point a time step of the world: x [m], z [m], angle [rad].
        stiffness: `()`, `(N,)` or `(N, T)` [N/m].
        seeds: of the beds, one a roll-out.
        progress: called with the simulated time [s] ten times a second of it.

    Raises:
        InvalidArgumentError: shapes that do not agree, or a first point out of reach.
    """
    N, dt = worlds.n, worlds.gravel.time_step
    n_steps = reference.shape[-2] - 1
    if n_steps < 1 or reference.shape not in ((n_steps + 1, 3), (N, n_steps + 1, 3)):
        raise InvalidArgumentError(f"reference has to be (T+1, 3) or ({N}, T+1, 3), got {tuple(reference.shape)}")
    if tuple(stiffness.shape) not in ((), (N,), (N, n_steps)):
        raise InvalidArgumentError(f"stiffness has to be (), ({N},) or ({N}, {n_steps}), got {tuple(stiffness.shape)}")
    with torch.inference_mode():
        reference = reference.detach().to(torch.float64).expand(N, -1, -1)
        s = stiffness.detach().to(torch.float64)
        s = (s if s.ndim == 2 else s.unsqueeze(-1)).expand(N, n_steps)
        rates = reference.diff(dim=1) / dt
        trials = Trials(worlds, reference[:, 0], seeds)
        for i in range(n_steps):
            trials.step(reference[:, i + 1], rates[:, i], s[:, i])
            if progress is not None and (i + 1) % round(SNAPSHOT / dt) == 0:
                progress((i + 1) * dt)
        return trials.recording()


def _in_plane(control: CartesianImpedance, pose: Tensor) -> Tensor:
    """Position and angle `(N, 3)` of poses `(N, 4, 4)`."""
    x, angle = control.in_plane(pose)
    return torch.cat([x, angle.unsqueeze(-1)], -1)
