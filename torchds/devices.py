"""Objects that move between devices and dtypes with all tensors that they hold.

Stability: experimental.
"""

from __future__ import annotations

import copy
from typing import Any, Self

import torch
from torch import Tensor

Device = torch.device | str | None


class Movable:
    """An object whose tensors are its attributes, or in attributes that can be moved themselves."""

    def to(self, device: Device = None, dtype: torch.dtype | None = None) -> Self:
        """A copy with everything on `device` and in `dtype`, where given; whole numbers and truths keep their dtype."""
        there = copy.copy(self)
        there.__dict__.update(moved(vars(self), device, dtype))
        return there


def moved(value: Any, device: Device = None, dtype: torch.dtype | None = None) -> Any:
    """Tensors, containers of them and whatever has a method `to`, on `device` and in `dtype`; all else as it is."""
    if isinstance(value, Tensor):
        return value.to(device, dtype if value.is_floating_point() else None)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*(moved(each, device, dtype) for each in value))
    if isinstance(value, (list, tuple)):
        return type(value)(moved(each, device, dtype) for each in value)
    if isinstance(value, dict):
        return {name: moved(each, device, dtype) for name, each in value.items()}
    if not isinstance(value, type) and callable(getattr(value, "to", None)):
        return value.to(device=device, dtype=dtype)
    return value
