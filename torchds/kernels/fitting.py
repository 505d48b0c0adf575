"""What fits into compiled loops, and why the rest does not.

Stability: experimental.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torchds.arrays import broadcast_shape
from torchds.kernels.choice import MISSING, Unfit, has, wanted
from torchds.kernels.fused import Field
from torchds.kernels.steps import ScalarStep, own

PRECISIONS = (torch.float64, torch.float32)


def check(*tensors: Tensor | None) -> None:
    """Refuse tensors that are not plain numbers in the memory of one device that there are kernels for.

    Raises:
        Unfit: with the reason.
    """
    if torch.compiler.is_compiling():
        raise Unfit("torch.compile and torch.export trace the eager loop")
    if forward_ad._current_level >= 0:
        raise Unfit("forward-mode derivatives need the eager loop")
    given = [tensor for tensor in tensors if tensor is not None]
    dtype, device = given[0].dtype, given[0].device
    if not has(device.type):
        raise Unfit(MISSING.get(device.type, f"there is no kernel for the device {device}"))
    for tensor in given:
        if tensor.device != device:
            raise Unfit(f"everything has to be on one device, got {device} and {tensor.device}")
        if tensor.dtype is not dtype or dtype not in PRECISIONS:
            raise Unfit("everything has to be float64, or everything float32")
        try:
            tensor.data_ptr()
        except RuntimeError:
            raise Unfit("functions transformed by torch.func need the eager loop") from None


def fusable(policy: Any, *tensors: Tensor) -> Field | None:
    """The field of `policy` if kernels are to work on it and on `tensors`, without gradients; None if not."""
    make = own(policy, "field")
    field: Field | None = None if make is None else make(policy.rows())
    return field if field is not None and fits(*tensors, *(t for t in field if isinstance(t, Tensor))) else None


def fits(*tensors: Tensor) -> bool:
    """Whether "auto" means a kernel of the CPU for these tensors, where nothing wants gradients.

    On a GPU, what is no loop over time stays a few operations on tensors.
    """
    if (
        wanted("auto") == "eager"
        or not tensors[0].is_cpu
        or (torch.is_grad_enabled() and any(t.requires_grad for t in tensors))
    ):
        return False
    try:
        check(*tensors)
    except Unfit:
        return False
    return all(t.numel() for t in tensors)


def scalar_step(part: Any, who: str, n_axes: int, n_rows: int, like: Tensor, lead: tuple[int, ...]) -> ScalarStep:
    """The scalar step that a stop condition or a plant brings, its parameters of the precision of `like`.

    Raises:
        Unfit: it brings none, or one that is not for roll-outs `lead`.
    """
    make = own(part, "scalar_step")
    step: ScalarStep | None = None if make is None else make(n_axes, n_rows)
    if step is None:
        raise Unfit(f"the {who} {type(part).__name__} has no scalar step (see torchds.kernels.ScalarStep)")
    force = step.force and step.force._replace(parameters=_plain(step.force.parameters, like, lead))
    return step._replace(parameters=_plain(step.parameters, like, lead), force=force)


def _plain(values: Tensor, like: Tensor, lead: tuple[int, ...]) -> Tensor:
    if values.requires_grad and torch.is_grad_enabled():
        raise Unfit("gradients for the parameters of a plant or a stop condition need the eager loop")
    own = tuple(values.shape[:-1])
    try:
        fits = broadcast_shape(own, lead) == lead
    except RuntimeError:
        fits = False
    if not fits:
        raise Unfit(f"the parameters of a plant or a stop condition are those of {own} roll-outs, not of {lead}")
    return values.detach().to(like)


def flat_state(state: Any, like: Tensor) -> Tensor:
    """The fields of a plant's state one after the other, `(*batch, *points, S)`.

    Raises:
        Unfit: fields of another precision or shape.
    """
    if any(not isinstance(f, Tensor) or f.dtype != like.dtype or f.shape[:-1] != state.x.shape[:-1] for f in state):
        raise Unfit("a field of the plant's state is no tensor (*batch, *points, n) of the policy's precision")
    return torch.cat(list(state), -1)
