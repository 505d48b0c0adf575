"""Which kernel makes a roll-out: that of the device on which the policy is.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchds.kernels import fused
from torchds.kernels.choice import Unfit
from torchds.kernels.fused import Field, Setting, Track


def roll_out(
    field: Field, start: Tensor, setting: Setting, definition: Callable[[Tensor, Tensor], tuple[Tensor, ...]]
) -> Track:
    """A roll-out in one compiled loop; see `torchds.kernels.fused.roll_out`.

    Raises:
        Unfit: on a GPU, where gradients are wanted; what the kernels raise.
    """
    if not field.rows.is_cuda:
        return fused.roll_out(field, start, setting, definition)
    if torch.is_grad_enabled() and (field.rows.requires_grad or start.requires_grad):
        raise Unfit("gradients on a GPU need the eager loop")
    from torchds.kernels import cuda

    return cuda.run(field, start, setting)
