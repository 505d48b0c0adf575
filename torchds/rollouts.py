"""Roll-outs: Eq. 4 over any batch of policies and any number of starts, one tensor call a time step.

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, Protocol

import torch
from torch import Tensor

from torchds import kernels, visits
from torchds.arrays import Array, count, like, number, over, without_autocast
from torchds.errors import InvalidArgumentError
from torchds.kernels import Backend, Setting, Unfit, own
from torchds.moments import Moment as Moment
from torchds.moments import Rollout as Rollout
from torchds.moments import advance, begin, record, seen
from torchds.plants import Plant
from torchds.scanning import Step, Taken, scanned
from torchds.stops import StopCondition
from torchds.visits import Gated

Shift = Array | Callable[[float], Array]
"""`(D,)`, `(*points, D)` or `(*batch, *points, D)`, or a function of the time [s] that returns one of these."""


class DynamicalSystem(visits.LinearPolicy, Protocol):
    """What a roll-out needs of a policy; `GMRPolicy` is one."""

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions of the parameters."""

    @property
    def input_dim(self) -> int:
        """D."""

    @property
    def output_dim(self) -> int:
        """O, the number of velocities."""

    @property
    def stiffness_dim(self) -> int:
        """Q, the number of stiffness outputs."""

    def features(self, x: Tensor) -> Tensor:
        """`(*batch, *points, F)` at `x` `(*batch, *points, D)`."""

    def outputs(self, features: Tensor, rows: Tensor) -> Tensor:
        """[ẋ; s] `(*batch, *points, O+Q)` from features and `rows`."""


def rollout(
    policy: DynamicalSystem,
    x0: Array,
    n_steps: int,
    dt: float,
    *,
    starts: Literal["shared", "per_policy"] = "shared",
    stop: StopCondition | None = None,
    plant: Plant | None = None,
    shift: Shift | None = None,
    feedback: bool = False,
    backend: Backend = "auto",
) -> Rollout:
    """Integrate ẋ = policy(x) from `x0` by Euler's method, x_{t+1} = x_t + ẋ_t dt (Eq. 4).

    Args:
        policy: a `GMRPolicy` or another `DynamicalSystem`, with any batch_shape.
        x0: `(*points, D)` starts that every policy of the batch sets out from; or, with starts="per_policy",
            `(*batch_shape, *points, D)` starts of each policy's own. Taken in the dtype of the policy.
        n_steps: T.
        dt: time step [s].
        starts: how the leading dimensions of `x0` are read.
        stop: a roll-out rests for good where this is True, which is asked of the reference where there is a plant; see
            `torchds.stops`.
        plant: what tracks the motion; the policy sees its own reference, never the plant (Eq. 32-34), but for `feedback`.
        shift: how far the whole field is moved, ẋ = policy(x − shift), also as a function of time: a motion that ends
            at x* then ends at x* + shift, and follows a target that moves (section 5.1).
        feedback: whether the policy sees where the plant is, a feedback law: the reference of a step is then x + policy(x) dt
            from the plant's x, at both of its ends. Without a plant it is the same motion.
        backend: "auto" for compiled code where there is some for all of this (`torchds.kernels`), else the eager loop, one
            tensor call a time step; "eager" or "fused" for that one. "scan" keeps the loop as one node of a graph, and is what
            "auto" means while torch.compile or torch.export reads a program; the time that a shift or a plant is told is a
            tensor then. Their numbers are the same but for round-off.

    Returns:
        A `Rollout`; differentiable with respect to the parameters and `x0`. States may diverge to infinity or NaN:
        that is data for the cost, not an error.

    Raises:
        InvalidArgumentError: wrong dimension or leading shape of `x0` or `shift`, n_steps < 1, dt ≤ 0, or a policy with
            fewer velocities than inputs; "fused" where that cannot be, with the reason.
    """
    D, O, batch, rows = policy.input_dim, policy.output_dim, policy.batch_shape, policy.rows()
    x0, n_steps = like("x0", x0, rows), count("n_steps", n_steps, 1)
    dt = number("dt", dt, "positive and finite", lambda step: 0 < step < math.inf)
    if x0.shape[-1:] != (D,):
        raise InvalidArgumentError(f"x0 has to end with the policy's {D} inputs, got shape {tuple(x0.shape)}")
    if starts not in ("shared", "per_policy"):
        raise InvalidArgumentError(f"starts has to be 'shared' or 'per_policy', got {starts!r}")
    if starts == "per_policy" and tuple(x0.shape[: len(batch)]) != batch:
        raise InvalidArgumentError(
            f"x0 {tuple(x0.shape)} has to begin with batch_shape {batch} for starts='per_policy'"
        )
    if O < D:
        raise InvalidArgumentError(f"a policy of {D} inputs has to have as many velocities or more, got {O}")
    lead = (*(() if starts == "per_policy" else batch), *x0.shape[:-1])
    if shift is not None and not callable(shift):
        shift = _checked_shift(shift, x0.expand(*lead, D))
    path, wanted = None, kernels.wanted(backend)
    if wanted == "scan" and (stop is not None or plant is not None) and _learns(rows, x0):
        if backend == "scan":
            raise InvalidArgumentError(
                "backend='scan' has no gradients where there is a stop condition or a plant, got one; take backend='eager', or "
                "torch.no_grad()"
            )
        wanted = "eager"
    if wanted in ("auto", "fused"):
        try:
            if feedback and plant is not None:
                raise Unfit("feedback from a plant needs the eager loop")
            path = _fused(policy, rows, x0, lead, n_steps, dt, stop, plant, shift)
        except Unfit as reason:
            if wanted == "fused":
                raise kernels.cannot(reason) from None
    if path is None:
        with without_autocast(x0):
            step = _step(policy, rows, dt, stop, plant, shift, feedback)
            start = begin(x0.expand(*lead, D), O, stop, plant)
            path = (scanned if wanted == "scan" else _eager)(step, start, n_steps, dt)
    visits.report(policy, path.visited)
    return path


def _learns(*tensors: Tensor) -> bool:
    return torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)


def _eager(step: Step, now: Moment, n_steps: int, dt: float) -> Rollout:
    """The definition of a roll-out, one tensor call a time step, from the moment at which it begins."""
    moments, features, stiffness, inputs = [now], [], [], []
    for i in range(n_steps):
        after, taken = step(now, i * dt)
        moments.append(after)
        features.append(taken.features)
        if taken.input is not now.x:
            inputs.append(taken.input)
        if taken.stiffness is not None:
            stiffness.append(taken.stiffness)
        now = after
    return record(moments, features, stiffness, dt, inputs)


def _step(
    policy: DynamicalSystem,
    rows: Tensor,
    dt: float,
    stop: StopCondition | None,
    plant: Plant | None,
    shift: Tensor | Callable[[float], Array] | None,
    feedback: bool = False,
) -> Step:
    """One step of the policy and of all that follows it, as a function of the moment and the time."""

    def step(now: Moment, t: Any) -> tuple[Moment, Taken]:
        x = seen(now, plant, t, dt) if feedback else now.x
        if shift is not None:
            x = x - (_checked_shift(shift(t), x) if callable(shift) else shift)
        g = policy.features(x)
        y = policy.outputs(g, rows)
        v, s = y[..., : policy.output_dim], y[..., policy.output_dim :] if policy.stiffness_dim else None
        return advance(now, v, s, t, dt, stop, plant, feedback), Taken(x, g, s)

    return step


def _fused(
    policy: DynamicalSystem,
    rows: Tensor,
    x0: Tensor,
    lead: tuple[int, ...],
    n_steps: int,
    dt: float,
    stop: StopCondition | None,
    plant: Plant | None,
    shift: Tensor | Callable[[float], Array] | None,
) -> Rollout:
    """The same in compiled code; raises `Unfit` with the reason where that cannot be."""
    D, Q = policy.input_dim, policy.stiffness_dim
    make = own(policy, "field")
    field = None if make is None else make(rows)
    if field is None:
        raise Unfit(f"{type(policy).__name__} makes its outputs in a way of its own")
    if callable(shift):
        raise Unfit("the shift is a function of time; a constant one would do")
    gating = (field.center, field.factors, field.offset, field.log_scale)
    kernels.check(rows, x0, *gating, shift)
    if _learns(*gating, *(() if shift is None else (shift,))):
        raise Unfit("gradients for the gating or the shift need the eager loop")
    if 0 in lead:
        raise Unfit("there is no roll-out")
    setting = Setting(lead, n_steps, float(dt), shift)
    if stop is not None:
        setting = setting._replace(stop=kernels.scalar_step(stop, "stop condition", D, Q, rows, lead))
    fields: Any = None
    if plant is not None:
        setting = setting._replace(plant=kernels.scalar_step(plant, "plant", D, Q, rows, lead))
        fields = plant.reset(x0.expand(*lead, D))
        setting = setting._replace(begin=kernels.flat_state(fields, rows))

    def definition(rows: Tensor, x: Tensor) -> tuple[Tensor, ...]:
        path = _eager(_step(policy, rows, dt, stop, None, shift), begin(x, policy.output_dim, stop), n_steps, dt)
        return path.reference, path.v, path.gating, *(() if path.stiffness is None else (path.stiffness,))

    track = kernels.roll_out(field, x0, setting, definition)
    x, v, tracked = track.reference, track.v, None
    if track.states is not None:
        widths = [f.shape[-1] for f in fields]
        tracked = type(fields)(*torch.split(track.states, widths, -1))
        x, v = tracked.x, tracked.v[..., 1:, :]
    inputs = track.reference[..., :-1, :]
    inputs = inputs if shift is None else inputs - shift.unsqueeze(-2)
    return Rollout(
        x=x,
        v=v,
        visited=Gated(track.gating, inputs),
        dt=dt,
        resting=track.resting,
        stiffness=track.stiffness if Q else None,
        reference=track.reference,
        inputs=inputs,
        plant=tracked,
    )


def _checked_shift(shift: Array, x: Tensor) -> Tensor:
    return over("shift", shift, x, "(..., D)")
