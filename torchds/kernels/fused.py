"""Tensors in and out of the compiled loops: shapes, gradients, and what does not fit.

Stability: experimental.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torchds.kernels.choice import wanted
from torchds.kernels.steps import ScalarStep, own


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

    def arrays(self) -> tuple[Any, ...]:
        """Rows and gating as arrays, all batches flat."""
        K, D = self.factors.shape[-3:-1]
        return (
            _flat(self.rows, *self.rows.shape[-2:]),
            _flat(self.center, D),
            _flat(self.factors, K, D, D),
            _flat(self.offset, K * D),
            _flat(self.log_scale, K),
            self.limit,
        )


class Unfit(Exception):
    """Why something cannot run in compiled code."""


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
        features: `(*batch, *points, T, K (D+1))`.
        stiffness: `(*batch, *points, T, Q)`, also for Q = 0.
        resting: `(*batch, *points, T)`; None without a stop condition.
        states: `(*batch, *points, T+1, S)` of the plant; None without one.
    """

    reference: Tensor
    v: Tensor
    features: Tensor
    stiffness: Tensor
    resting: Tensor | None = None
    states: Tensor | None = None


def check(*tensors: Tensor | None) -> None:
    """Refuse tensors that are not plain numbers in the memory of the CPU.

    Raises:
        Unfit: with the reason.
    """
    if torch.compiler.is_compiling():
        raise Unfit("torch.compile and torch.export trace the eager loop")
    given = [tensor for tensor in tensors if tensor is not None]
    for tensor in given:
        if tensor.device.type != "cpu":
            raise Unfit(f"there is no kernel for the device {tensor.device}")
        if tensor.dtype != given[0].dtype or tensor.dtype not in (torch.float64, torch.float32):
            raise Unfit("everything has to be float64, or everything float32")
        if forward_ad.unpack_dual(tensor).tangent is not None:  # type: ignore[no-untyped-call]
            raise Unfit("forward-mode derivatives need the eager loop")
        try:
            tensor.data_ptr()
        except RuntimeError:
            raise Unfit("functions transformed by torch.func need the eager loop") from None


def fusable(policy: Any, *tensors: Tensor) -> Field | None:
    """The field of `policy` if kernels are to work on it and on `tensors`, without gradients; None if not."""
    make = own(policy, "field")
    field: Field | None = None if make is None else make()
    return field if field is not None and fits(*tensors, *(t for t in field if isinstance(t, Tensor))) else None


def fits(*tensors: Tensor) -> bool:
    """Whether "auto" means a kernel for these tensors, where nothing wants gradients."""
    if wanted("auto") == "eager" or (torch.is_grad_enabled() and any(t.requires_grad for t in tensors)):
        return False
    try:
        check(*tensors)
    except Unfit:
        return False
    return all(t.numel() for t in tensors)


def scalar_step(part: Any, who: str, n_axes: int, n_rows: int, like: Tensor) -> ScalarStep:
    """The scalar step that a stop condition or a plant brings, its parameters of the precision of `like`.

    Raises:
        Unfit: it brings none.
    """
    make = own(part, "scalar_step")
    step: ScalarStep | None = None if make is None else make(n_axes, n_rows)
    if step is None:
        raise Unfit(f"the {who} {type(part).__name__} has no scalar step (see torchds.kernels.ScalarStep)")
    force = step.force and step.force._replace(parameters=_plain(step.force.parameters, like))
    return step._replace(parameters=_plain(step.parameters, like), force=force)


def _plain(values: Tensor, like: Tensor) -> Tensor:
    if values.requires_grad and torch.is_grad_enabled():
        raise Unfit("gradients for the parameters of a plant or a stop condition need the eager loop")
    return values.detach().to(like)


def flat_state(state: Any, like: Tensor) -> Tensor:
    """The fields of a plant's state one after the other, `(*batch, *points, S)`.

    Raises:
        Unfit: fields of another precision or shape.
    """
    if any(not isinstance(f, Tensor) or f.dtype != like.dtype or f.shape[:-1] != state.x.shape[:-1] for f in state):
        raise Unfit("a field of the plant's state is no tensor (*batch, *points, n) of the policy's precision")
    return torch.cat(list(state), -1)


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
    reference, v, features, stiffness, resting = written
    return Track(reference, v, features, stiffness, None if setting.stop is None else resting)


def sensitivity(field: Field, inputs: Tensor, resting: Tensor | None, dt: float) -> Tensor:
    """∂(reference, integrals)/∂θ `(*batch, *points, T, O, P)` along `inputs` `(*batch, *points, T, D)`."""
    from torchds.kernels import gradients

    lead, (T, D), (N, F) = inputs.shape[:-2], inputs.shape[-2:], field.rows.shape[-2:]
    n = math.prod(lead)
    motion = inputs.new_empty(*lead, T, field.n_velocities, N * F)
    rests = None if resting is None else _flat(resting, T)
    arguments = ((0,) * D, (0,) * N, _points(field, n), dt, *field.arrays(), _flat(inputs, T, D), rests)
    _in_threads(gradients.sensitivities, n, T, *arguments, _flat(motion, *motion.shape[-3:]))
    return motion


def stiffness_sensitivity(field: Field, inputs: Tensor, motion: Tensor) -> Tensor:
    """∂s/∂θ `(*batch, *points, T, Q, P)`, from the result of `sensitivity`."""
    from torchds.kernels import gradients

    lead, (T, D), (N, F) = inputs.shape[:-2], inputs.shape[-2:], field.rows.shape[-2:]
    n = math.prod(lead)
    stiffness = inputs.new_empty(*lead, T, N - field.n_velocities, N * F)
    arguments = ((0,) * D, (0,) * N, _points(field, n), *field.arrays(), _flat(inputs, T, D))
    arrays = (_flat(value, *value.shape[-3:]) for value in (motion, stiffness))
    _in_threads(gradients.stiffness_sensitivities, n, T, *arguments, *arrays)
    return stiffness


def control_cost(deviation: Tensor, noise: Tensor, features: Tensor, weight: Tensor) -> Tensor:
    """Υ `(*batch, *points, T)` of `torchds.costs.control_cost`, all arguments with the same leading dimensions or ones."""
    from torchds.kernels import gradients

    shapes = (t.shape[:-2] for t in (deviation, noise, features, weight))
    lead = torch.broadcast_shapes(*shapes)  # type: ignore[no-untyped-call]
    (O, F), T = deviation.shape[-2:], features.shape[-2]
    upsilon = features.new_empty(*lead, T)
    rows = [_flat(rows.expand(*lead, O, F), O, F) for rows in (deviation, noise, weight)]
    arrays = (*rows, _flat(features.expand(*lead, T, F), T, F), _flat(upsilon, T))
    _in_threads(gradients.control, len(arrays[-1]), T, *arrays)
    return upsilon


# ---------------------------------------------------------------------- inside


def _flat(tensor: Tensor, *core: int) -> Any:
    """A tensor `(*lead, *core)` as an array `(n, *core)`, without a copy where it is in order."""
    if tensor.requires_grad:
        tensor = tensor.detach()
    return tensor.contiguous().numpy().reshape(-1, *core)


def _points(field: Field, n: int) -> int:
    return n // max(1, math.prod(field.rows.shape[:-2]))


def _each(values: Tensor, lead: tuple[int, ...]) -> Any:
    """Parameters as for a `ScalarStep`, as an array of which roll-out i uses row i % len."""
    own = tuple(values.shape[:-1])
    if lead[len(lead) - len(own) :] != own:
        values = values.expand(*lead, values.shape[-1])
    return _flat(values, values.shape[-1])


def _in_threads(kernel: Any, n: int, n_steps: int, *arguments: Any) -> None:
    from torchds.kernels import compiling

    compiling.in_threads(kernel, n, n_steps, torch.get_num_threads(), *arguments)


def _function(step: ScalarStep | None) -> Callable[..., Any] | None:
    return step.function if step is not None and callable(step.function) else None


def _kind(step: ScalarStep | None) -> int:
    return step.function if step is not None and isinstance(step.function, int) else 0


def _run(field: Field, start: Tensor, setting: Setting) -> Track:
    from torchds.kernels import cpu

    lead, T = setting.lead, setting.n_steps
    D, N = start.shape[-1], field.rows.shape[-2]
    O, n = field.n_velocities, math.prod(lead)
    new = field.rows.new_empty
    track = Track(new(*lead, T + 1, D), new(*lead, T, O), new(*lead, T, field.rows.shape[-1]), new(*lead, T, N - O))
    written = [t.numpy().reshape(n, *t.shape[-2:]) for t in track[:4]]
    stop, plant, force = setting.stop, setting.plant, None
    stopping = tracking = None
    if stop is not None:
        resting = torch.empty(*lead, T, dtype=torch.bool)
        track = track._replace(resting=resting)
        stopping = (_kind(stop), _each(stop.parameters, lead), resting.numpy().reshape(n, T))
    if plant is not None and setting.begin is not None:
        force, S = plant.force, setting.begin.shape[-1]
        states = new(*lead, T + 1, S)
        states[..., 0, :] = setting.begin
        track = track._replace(states=states)
        p, q = (_each(new(1) if step is None else step.parameters, lead) for step in (plant, force))
        tracking = (_kind(plant), p, _kind(force), q, states.numpy().reshape(n, T + 1, S))
    functions = (_function(stop), _function(force), _function(plant))
    kernel = cpu.extended(*functions) if any(functions) else cpu.rollouts
    shift = _each(field.center.new_zeros(D) if setting.shift is None else setting.shift, lead)
    arguments = ((0,) * D, (0,) * N, _points(field, n), setting.dt, _flat(start, D), *field.arrays(), *written)
    _in_threads(kernel, n, T, *arguments, shift, stopping, tracking)
    return track


class _Differentiable(torch.autograd.Function):
    """A roll-out whose backward pass is the adjoint loop."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, start: Tensor, field: Field, setting: Setting, definition: Any) -> Any:
        track = _run(field, start, setting)
        resting = track.reference.new_empty(0, dtype=torch.bool) if track.resting is None else track.resting
        ctx.mark_non_differentiable(resting)
        ctx.save_for_backward(rows, start, track.reference, track.features, resting)
        ctx.field, ctx.setting, ctx.definition = field, setting, definition
        return *track[:4], resting

    @staticmethod
    def backward(ctx: Any, *received: Tensor) -> Any:
        from torchds.kernels import gradients

        rows, start, reference, features, resting = ctx.saved_tensors
        field, setting, on = ctx.field._replace(rows=rows), ctx.setting, received[:4]
        if torch.is_grad_enabled():  # create_graph=True: the adjoint itself is to have derivatives
            written = ctx.definition(rows, start)
            wanted = [t for t, wants in zip((rows, start), ctx.needs_input_grad[:2], strict=True) if wants]
            found = iter(torch.autograd.grad(written, wanted, on[: len(written)], create_graph=True, allow_unused=True))
            return *(next(found) if wants else None for wants in ctx.needs_input_grad[:2]), None, None, None
        lead, T, D, n = setting.lead, setting.n_steps, start.shape[-1], math.prod(setting.lead)
        inputs = reference[..., :-1, :]
        if setting.shift is not None:
            inputs = inputs - setting.shift.unsqueeze(-2)
        N, F = rows.shape[-2:]
        on_rows, on_start = rows.new_empty(*lead, N, F), rows.new_empty(*lead, D)
        arrays = (_flat(inputs, T, D), _flat(features, T, F), None if setting.stop is None else _flat(resting, T))
        arrays += tuple(_flat(g, *g.shape[-2:]) if g.numel() else g.numpy().reshape(n, T, 0) for g in on)
        points = _points(field, n)
        arguments = ((0,) * D, (0,) * N, points, setting.dt, *field.arrays(), *arrays)
        _in_threads(gradients.adjoint, n, T, *arguments, _flat(on_rows, N, F), _flat(on_start, D))
        return on_rows.reshape(*rows.shape[:-2], points, N, F).sum(-3), on_start, None, None, None
