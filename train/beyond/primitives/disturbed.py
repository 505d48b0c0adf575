"""Motions that are pushed, held, or begun elsewhere, and what becomes of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from tasks import Motion
from torchds import GMRPolicy
from torchds.dmp import DMP, State

NEAR = 0.5  # of a via-point that was passed [position unit]
DIRECTIONS = 8  # of pushes and of other starts, evenly around


class Disturbance(NamedTuple):
    """What happens to a motion.

    Attributes:
        name: of it.
        start: `(*points, O)` how far beside its start it begins [position unit].
        push: `(*points, O)` by how much it is displaced in one step, of which it knows only where it is after.
        at: step of the push, or the first step that it is held for.
        held: steps for which it stays where it is; the clock of a primitive goes on.
        late: steps that it is given beyond the motion's own.
    """

    name: str
    start: Tensor
    push: Tensor
    at: int = 0
    held: int = 0
    late: int = 0


class Measures(NamedTuple):
    """What became of a motion, `(*batch, *points)` each, in position units where nothing is said.

    Attributes:
        passed: share of the via-points that it came nearer than `NEAR`.
        end: distance from the goal at the end.
        path: mean distance from the undisturbed path, whatever the time, after the disturbance.
        clock: mean distance from where the undisturbed motion is at that time, after the disturbance.
    """

    passed: Tensor
    end: Tensor
    path: Tensor
    clock: Tensor


def disturbances(motion: Motion, distance: float, seconds: float) -> Iterator[Disturbance]:
    """None, and four: pushed at 2/5 of the motion, held there for some seconds, begun elsewhere, left to itself in the end."""
    angle = 2 * math.pi / DIRECTIONS * torch.arange(DIRECTIONS, dtype=motion.x0.dtype)
    around = distance * torch.stack([angle.cos(), angle.sin()], -1)
    none, at, held = torch.zeros_like(around[:1]), round(0.4 * motion.n_steps), round(seconds / motion.dt)
    yield Disturbance("none", none, none)
    yield Disturbance("pushed", none, around, at)
    yield Disturbance("held", none, none, at, held, late=held)
    yield Disturbance("begun elsewhere", around, none)
    yield Disturbance("left to itself", none, none, late=motion.n_steps)


@torch.no_grad()
def follow(policy: GMRPolicy, motion: Motion, disturbance: Disturbance) -> Tensor:
    """The places `(*batch, *points, T + late + 1, O)` of policies under a disturbance."""
    x0, n_steps, dt = motion
    places = x0 + disturbance.start + 0 * disturbance.push
    if isinstance(policy, DMP):
        now = policy.begin(places)
    else:
        y = places.expand(*policy.batch_shape, *places.shape)
        now = State(y, torch.zeros_like(y), y.new_ones(1))
    track = [now.y]
    for step in range(n_steps + disturbance.late):
        if step == disturbance.at:
            now = now._replace(y=now.y + disturbance.push)
        after = policy.step(now, dt) if isinstance(policy, DMP) else now._replace(y=now.y + dt * policy(now.y))
        if 0 <= step - disturbance.at < disturbance.held:
            after = after._replace(y=now.y, z=torch.zeros_like(now.z))
        now = after
        track.append(now.y)
    return torch.stack(track, -2)


def measures(x: Tensor, whole: Tensor, disturbance: Disturbance, goal: Tensor, via_points: Tensor) -> Measures:
    """What became of a motion.

    Args:
        x: `(*batch, *points, T + late + 1, O)` its places.
        whole: `(*batch, 1, T+1, O)` those of the undisturbed motion.
        disturbance: of it.
        goal: `(O,)`.
        via_points: `(L, O)`.
    """
    after = disturbance.at + disturbance.held + 1
    rest, still = x[..., after:, :], x.shape[-2] - whole.shape[-2]
    ahead = torch.cat([whole, whole[..., -1:, :].expand(*whole.shape[:-2], still, whole.shape[-1])], -2)[..., after:, :]
    distance = torch.linalg.vector_norm(rest.unsqueeze(-2) - whole.unsqueeze(-3), dim=-1)  # (..., T', T+1)
    near = torch.linalg.vector_norm(x.unsqueeze(-2) - via_points, dim=-1).amin(-2)
    return Measures(
        passed=(near < NEAR).to(x.dtype).mean(-1),
        end=torch.linalg.vector_norm(x[..., -1, :] - goal, dim=-1),
        path=distance.amin(-1).mean(-1),
        clock=torch.linalg.vector_norm(rest - ahead, dim=-1).mean(-1),
    )
