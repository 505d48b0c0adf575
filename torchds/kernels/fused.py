"""Tensors in and out of the compiled loops of the CPU: shapes, threads and gradients.

Stability: experimental.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchds.arrays import broadcast_shape
from torchds.kernels.choice import Unfit
from torchds.kernels.steps import NONE, OWN, ScalarStep
from torchds.visits import Gated


class Field(NamedTuple):
    """A mixture of linear systems behind one gating, as compiled code needs it.

    Attributes:
        rows: `(*batch, O+Q, K (D+1))` one row per output (`GMRPolicy.rows`).
        n_velocities: O.
        center: `(*gate_batch, D)` where distances are taken from, c.
        factors: `(*gate_batch, K, D, D)` W_k with Σ_k⁻¹ = W_kᵀ W_k.
        offset: `(*gate_batch, K D)` W_k (c − μ_k).
        log_scale: `(*gate_batch, K)` log of π_k |W_k|.
    """

    rows: Tensor
    n_velocities: int
    center: Tensor
    factors: Tensor
    offset: Tensor
    log_scale: Tensor

    @property
    def limit(self) -> float:
        """The largest whitened distance whose square is finite, as in `GMRPolicy.gating`."""
        return float(torch.finfo(self.rows.dtype).max ** 0.5 / (4 * self.center.shape[-1]))

    def gate(self) -> tuple[Any, ...]:
        """The gating as arrays, all batches flat."""
        return (
            _flat(self.center, 1),
            _flat(self.factors, 3),
            _flat(self.offset, 1),
            _flat(self.log_scale, 1),
            self.limit,
        )

    def arrays(self) -> tuple[Any, ...]:
        """Rows and gating as arrays, all batches flat."""
        return _flat(self.rows, 2), *self.gate()


class Setting(NamedTuple):
    """What a roll-out depends on beside the field and the starts.

    Attributes:
        lead: `(*batch, *points)`.
        n_steps: T.
        dt: time step [s].
        shift: see `torchds.rollout`; None for none.
        stop: of the stop condition.
        plant: of the plant.
        begin: `(*batch, *points, S)` the state of the plant at the start, its fields one after the other.
    """

    lead: tuple[int, ...]
    n_steps: int
    dt: float
    shift: Tensor | None = None
    stop: ScalarStep | None = None
    plant: ScalarStep | None = None
    begin: Tensor | None = None


class Track(NamedTuple):
    """What a fused roll-out writes; see `torchds.Rollout`.

    Attributes:
        reference: `(*batch, *points, T+1, D)`.
        v: `(*batch, *points, T, O)` of the reference.
        gating: `(*batch, *points, T, K)` h_k at what the policy saw.
        stiffness: `(*batch, *points, T, Q)`, also for Q = 0.
        resting: `(*batch, *points, T)`; None without a stop condition.
        states: `(*batch, *points, T+1, S)` of the plant; None without one.
    """

    reference: Tensor
    v: Tensor
    gating: Tensor
    stiffness: Tensor
    resting: Tensor | None = None
    states: Tensor | None = None


def roll_out(
    field: Field, start: Tensor, setting: Setting, definition: Callable[[Tensor, Tensor], tuple[Tensor, ...]]
) -> Track:
    """A roll-out in one compiled loop, with gradients where rows or starts want them.

    Args:
        field: the policy.
        start: `(*points, D)` or `(*batch, *points, D)`.
        setting: all else.
        definition: the eager roll-out, from rows and starts `(*batch, *points, D)` to the first four of a `Track`: the way
            of derivatives of derivatives.

    Raises:
        Unfit: with a plant, where gradients are wanted.
    """
    if not (torch.is_grad_enabled() and (field.rows.requires_grad or start.requires_grad)):
        return _run(field, start, setting)
    if setting.plant is not None:
        raise Unfit("gradients through a plant need the eager loop")
    start = start.expand(*setting.lead, start.shape[-1])
    written = _Differentiable.apply(field.rows, start, field, setting, definition)  # type: ignore[no-untyped-call]
    reference, v, gating, stiffness, resting = written
    return Track(reference, v, gating, stiffness, None if setting.stop is None else resting)


def sensitivity(field: Field, inputs: Tensor, resting: Tensor | None, dt: float) -> Tensor:
    """∂(reference, integrals)/∂θ `(*batch, *points, T, O, P)` along `inputs` `(*batch, *points, T, D)`."""
    from torchds.kernels import gradients

    *lead, T, _ = inputs.shape
    N, F = field.rows.shape[-2:]
    motion = inputs.new_empty(*lead, T, field.n_velocities, N * F)
    arrays = (float(dt), *field.arrays(), _flat(inputs, 2), _rests(resting), _flat(motion, 3))
    _over(field, gradients.sensitivities, math.prod(lead), T, (), *arrays)
    return motion


def stiffness_sensitivity(field: Field, inputs: Tensor, motion: Tensor) -> Tensor:
    """∂s/∂θ `(*batch, *points, T, Q, P)`, from the result of `sensitivity`."""
    from torchds.kernels import gradients

    *lead, T, _ = inputs.shape
    N, F = field.rows.shape[-2:]
    stiffness = inputs.new_empty(*lead, T, N - field.n_velocities, N * F)
    arrays = (*field.arrays(), _flat(inputs, 2), _flat(motion, 3), _flat(stiffness, 3))
    _over(field, gradients.stiffness_sensitivities, math.prod(lead), T, (), *arrays)
    return stiffness


def control_cost(deviation: Tensor, noise: Tensor, features: Gated, weight: Tensor) -> Tensor:
    """Υ `(*batch, *points, T)` of `torchds.costs.control_cost`, all arguments with the same leading dimensions or ones."""
    from torchds.kernels import gradients

    given = (deviation, noise, weight, *features)
    lead = broadcast_shape(*(t.shape[:-2] for t in given))
    (T, K), D, n = features.gating.shape[-2:], features.inputs.shape[-1], math.prod(lead)
    arrays = [_each(t, lead, 2) for t in given]
    upsilon = np.empty((n, T), arrays[0].dtype)
    _in_threads(gradients.control, (noise.dtype,), (D, K), n, T, *arrays, upsilon)
    return _tensor(upsilon, lead)


# ---------------------------------------------------------------------- inside


def _flat(tensor: Tensor, core: int) -> Any:
    """A tensor `(*lead, *core)` as an array `(n, *core)`, without a copy where it is in order; `core` last axes."""
    if tensor.requires_grad:
        tensor = tensor.detach()
    lead = tensor.shape[: tensor.ndim - core]
    array = tensor.contiguous().numpy()
    return array if len(lead) == 1 else array.reshape(math.prod(lead), *tensor.shape[len(lead) :])


def _tensor(array: Any, lead: tuple[int, ...]) -> Tensor:
    """An array `(n, *core)` as a tensor `(*lead, *core)` of the same memory."""
    tensor = torch.from_numpy(array)
    return tensor if len(lead) == 1 else tensor.view(*lead, *array.shape[1:])


def recurring(values: Tensor, lead: tuple[int, ...], core: int = 1) -> Tensor:
    """A tensor that broadcasts to `(*lead, *core)` so that roll-out i uses entry i % (how many there are); `core` last axes."""
    while values.ndim > core and values.shape[0] == 1:
        values = values[0]
    own = tuple(values.shape[: values.ndim - core])
    return values if lead[len(lead) - len(own) :] == own else values.expand(*lead, *values.shape[len(own) :])


def _each(values: Tensor, lead: tuple[int, ...], core: int = 1) -> Any:
    return _flat(recurring(values, lead, core), core)


def _rests(resting: Tensor | None) -> Any:
    return np.empty((0, 0), dtype=bool) if resting is None else _flat(resting, 1)


def _over(field: Field, loop: Any, n: int, n_steps: int, form: tuple[bool, ...], *arrays: Any) -> None:
    """Run a loop over the `n` roll-outs of a field's policies."""
    K, D = field.factors.shape[-3:-1]
    n_points = n // math.prod(field.rows.shape[:-2])
    _in_threads(loop, (field.rows.dtype, *form), (D, K), n, n_steps, n_points, *arrays)


def _in_threads(loop: Any, form: Any, sizes: tuple[int, ...], n: int, n_steps: int, *arguments: Any) -> None:
    from torchds.kernels import compiling

    compiling.run(loop, form, sizes, n, n_steps, torch.get_num_threads(), *arguments)


def _function(step: ScalarStep | None) -> Callable[..., Any] | None:
    return step.function if step is not None and callable(step.function) else None


def _numbers(step: ScalarStep, lead: tuple[int, ...]) -> tuple[int, Any]:
    """Kind and parameters of a step, for compiled code."""
    return step.function if isinstance(step.function, int) else OWN, _each(step.parameters, lead)


def _run(field: Field, start: Tensor, setting: Setting) -> Track:
    from torchds.kernels import cpu

    lead, T, D, O = setting.lead, setting.n_steps, start.shape[-1], field.n_velocities
    N, K, n, rows = field.rows.shape[-2], field.factors.shape[-3], math.prod(lead), _flat(field.rows, 2)
    written = [np.empty((n, *core), rows.dtype) for core in ((T + 1, D), (T, O), (T, K), (T, N - O))]
    track = Track(*(_tensor(array, lead) for array in written))
    nothing = np.zeros((1, D), rows.dtype)
    stop, plant, force = setting.stop, setting.plant, None
    stopping: Any = None
    tracking: Any = None
    if stop is not None:
        track = track._replace(resting=torch.empty(*lead, T, dtype=torch.bool))
        stopping = (*_numbers(stop, lead), _rests(track.resting))
    if plant is not None and setting.begin is not None:
        force, states = plant.force, np.empty((n, T + 1, setting.begin.shape[-1]), rows.dtype)
        states[:, 0] = _flat(setting.begin, 1)
        track = track._replace(states=_tensor(states, lead))
        pushing = (NONE, nothing) if force is None else _numbers(force, lead)
        tracking = (*_numbers(plant, lead), *pushing, states)
    functions = (_function(stop), _function(force), _function(plant))
    loop = cpu.extended(*functions) if any(functions) else cpu.roll
    shift = nothing if setting.shift is None else _each(setting.shift, lead)
    arrays = (setting.dt, _flat(start, 1), rows, *field.gate(), *written, shift, stopping, tracking)
    _over(field, loop, n, T, (stop is None, plant is None), *arrays)
    return track


class _Differentiable(torch.autograd.Function):
    """A roll-out whose backward pass is the adjoint loop."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, start: Tensor, field: Field, setting: Setting, definition: Any) -> Any:
        track = _run(field, start, setting)
        resting = track.reference.new_empty(0, dtype=torch.bool) if track.resting is None else track.resting
        ctx.mark_non_differentiable(resting)
        ctx.save_for_backward(rows, start, track.reference, track.gating, resting)
        ctx.field, ctx.setting, ctx.definition = field, setting, definition
        return *track[:4], resting

    @staticmethod
    def backward(ctx: Any, *received: Tensor) -> Any:
        from torchds.kernels import gradients

        rows, start, reference, gating, resting = ctx.saved_tensors
        field, setting, on = ctx.field._replace(rows=rows), ctx.setting, received[:4]
        if torch.is_grad_enabled():  # create_graph=True: the adjoint itself is to have derivatives
            written = ctx.definition(rows, start)
            wanted = [t for t, wants in zip((rows, start), ctx.needs_input_grad[:2], strict=True) if wants]
            found = iter(torch.autograd.grad(written, wanted, on[: len(written)], create_graph=True, allow_unused=True))
            return *(next(found) if wants else None for wants in ctx.needs_input_grad[:2]), None, None, None
        lead, T, D = setting.lead, setting.n_steps, start.shape[-1]
        inputs = reference[..., :-1, :]
        if setting.shift is not None:
            inputs = inputs - setting.shift.unsqueeze(-2)
        N, F = rows.shape[-2:]
        on_rows, on_start = rows.new_empty(*lead, N, F), rows.new_empty(*lead, D)
        path = (_flat(inputs, 2), _flat(gating, 2), _rests(None if setting.stop is None else resting))
        gradients_on = (*(_flat(g, 2) for g in on), _flat(on_rows, 2), _flat(on_start, 1))
        arrays = (setting.dt, *field.arrays(), *path, *gradients_on)
        _over(field, gradients.adjoint, math.prod(lead), T, (), *arrays)
        return on_rows.reshape(*rows.shape[:-2], -1, N, F).sum(-3), on_start, None, None, None
