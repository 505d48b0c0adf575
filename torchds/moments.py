"""One step of a roll-out, and what a roll-out keeps of all of them.

Stability: stable.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchds.devices import Movable
from torchds.plants import Command, Plant
from torchds.stops import StopCondition
from torchds.visits import Gated, whole


@dataclass(frozen=True)
class Rollout(Movable):
    """What happened along a roll-out.

    Attributes:
        x: `(*batch, *points, T+1, D)` states, the start first; of the plant where there is one.
        v: `(*batch, *points, T, O)` velocities of the steps; zero once a roll-out rests. With a plant, its velocities
            at the ends of the steps, `(..., T, D)`.
        visited: the features that the policy saw, from which `features` and `gating` are made.
        dt: time step [s].
        resting: `(*batch, *points, T)` True where a stop condition kept the step from being taken; None without one.
        stiffness: `(*batch, *points, T, Q)` what the policy asked for [N/m], before any limits; what a plant applied is
            `plant.stiffness`. None for a policy without stiffness.
        reference: `(*batch, *points, T+1, D)` the motion that the policy generates; `x` itself without a plant.
        inputs: `(*batch, *points, T, D)` what the policy saw, less the shift: the first T reference states, or with feedback
            those of the plant.
        plant: all that the plant went through (a `PointMassState` for a point mass), each field `(*batch, *points, T+1, ...)`;
            None without a plant.
    """

    x: Tensor
    v: Tensor
    visited: Tensor | Gated
    dt: float
    resting: Tensor | None
    stiffness: Tensor | None
    reference: Tensor
    inputs: Tensor
    plant: Any

    @functools.cached_property
    def features(self) -> Tensor:
        """`(*batch, *points, T, K (D+1))` h_k(x) [x, 1] at the inputs."""
        return whole(self.visited)

    @property
    def gating(self) -> Tensor:
        """h_k `(*batch, *points, T, K)` at the inputs."""
        D = self.reference.shape[-1]
        return self.visited.gating if isinstance(self.visited, Gated) else self.visited[..., D :: D + 1]

    @property
    def stopped(self) -> Tensor:
        """`(*batch, *points)` True for the roll-outs that came to rest before the end."""
        if self.resting is None:
            return torch.zeros(self.x.shape[:-2], dtype=torch.bool, device=self.x.device)
        return self.resting[..., -1]


class Moment(NamedTuple):
    """Where a roll-out is between two steps: all that the next one depends on.

    Attributes:
        x: `(*batch, *points, D)` reference position.
        v: `(*batch, *points, O)` reference velocity of the step that led here; zero at the start.
        resting: `(*batch, *points)` True where a stop condition holds it; None without one.
        plant: the state of the plant; None without one.
    """

    x: Tensor
    v: Tensor
    resting: Tensor | None
    plant: Any


def begin(x: Tensor, n_velocities: int, stop: StopCondition | None = None, plant: Plant | None = None) -> Moment:
    """At rest at the starts `x` `(*batch, *points, D)`, for a policy of `n_velocities`."""
    return Moment(
        x,
        v=x.new_zeros(*x.shape[:-1], n_velocities),
        resting=None if stop is None else torch.zeros(x.shape[:-1], dtype=torch.bool, device=x.device),
        plant=None if plant is None else plant.reset(x),
    )


def seen(now: Moment, plant: Plant | None, t: float, dt: float) -> Tensor:
    """`(*batch, *points, D)` what a policy with feedback sees: where the plant is or says that it is, else the reference."""
    if plant is None:
        return now.x
    measure = getattr(plant, "measured", None)
    x: Tensor = now.plant.x if measure is None else measure(now.plant, t, dt)
    return x[..., : now.x.shape[-1]]


def advance(
    now: Moment,
    v: Tensor,
    stiffness: Tensor | None,
    t: float,
    dt: float,
    stop: StopCondition | None = None,
    plant: Plant | None = None,
    feedback: bool = False,
) -> Moment:
    """One step of Eq. 4, and of the plant that tracks it.

    Args:
        now: before the step.
        v: `(*batch, *points, O)` the velocity that a policy gives.
        stiffness: `(*batch, *points, Q)` the stiffness that it gives [N/m]; None for none.
        t: time before the step [s].
        dt: time step [s].
        stop: as for `begin`; see `rollout`.
        plant: as for `begin`; see `rollout`.
        feedback: whether the step begins where the plant is; see `rollout`.
    """
    base = seen(now, plant, t, dt) if feedback else now.x
    x, resting, state = torch.add(base, v[..., : base.shape[-1]], alpha=dt), now.resting, now.plant
    if stop is not None and resting is not None:
        resting = resting | stop(base, x)
        keep = resting.unsqueeze(-1)
        x, v = torch.where(keep, now.x, x), v.masked_fill(keep, 0.0)
    if plant is not None:
        before = (x, v) if feedback else (now.x, now.v)  # a reference from the plant's place has none before it
        state = plant.step(state, Command(before[0], x, before[1], v, stiffness, t, dt))
    return Moment(x, v, resting, state)


def record(
    moments: Sequence[Moment],
    features: Sequence[Tensor],
    stiffness: Sequence[Tensor],
    dt: float,
    inputs: Sequence[Tensor] = (),
) -> Rollout:
    """The roll-out that T + 1 moments make, with what the policy saw and asked for in the T steps between them.

    Args:
        moments: T + 1 of them.
        features: T of them, `(*batch, *points, K (D+1))` each.
        stiffness: T of them, `(*batch, *points, Q)` each [N/m]; empty for a policy without.
        dt: time step [s].
        inputs: T of them, `(*batch, *points, D)` each; empty where these are the first T reference states.
    """
    steps, time = moments[1:], moments[0].x.ndim - 1
    reference = torch.stack([moment.x for moment in moments], -2)
    states = [moment.plant for moment in moments]
    tracked = None
    if states[0] is not None:
        tracked = type(states[0])(*(torch.stack(f, time) for f in zip(*states, strict=True)))
    rests = [step.resting for step in steps if step.resting is not None]
    return Rollout(
        x=reference if tracked is None else tracked.x,
        v=torch.stack([step.v for step in steps], -2) if tracked is None else tracked.v[..., 1:, :],
        visited=torch.stack(list(features), -2),
        dt=dt,
        resting=torch.stack(rests, -1) if rests else None,
        stiffness=torch.stack(list(stiffness), -2) if stiffness else None,
        reference=reference,
        inputs=torch.stack(list(inputs), -2) if inputs else reference[..., :-1, :],
        plant=tracked,
    )
