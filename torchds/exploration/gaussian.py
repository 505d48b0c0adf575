"""Independent Gaussian noise on any parameters."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration


class Gaussian(Exploration):
    """ε = std · z, for the parameters of any module.

    Args:
        std: one number for all parameters, or one number or tensor for each parameter of the group, which has to
            broadcast with it.

    Raises:
        InvalidArgumentError: a standard deviation that is negative or not finite; later, from the optimizer, one that
            does not fit its parameter.
    """

    def __init__(self, std: float | Sequence[float | Tensor]) -> None:
        for value in [std] if isinstance(std, (int, float)) else std:
            entries = torch.as_tensor(value)
            if not entries.isfinite().all() or (entries < 0).any():
                raise InvalidArgumentError(f"std has to be finite and ≥ 0, got {value}")
        self.std = std

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse a number or shapes of parameters that `std` does not fit."""
        if isinstance(self.std, (int, float)):
            return
        shapes = [tuple(p.shape) for p in parameters]
        if len(self.std) != len(shapes):
            raise InvalidArgumentError(f"{len(self.std)} values of std for {len(shapes)} parameters {shapes}")
        for value, shape in zip(self.std, shapes, strict=True):
            try:
                fits = torch.broadcast_shapes(torch.as_tensor(value).shape, shape) == shape
            except RuntimeError:
                fits = False
            if not fits:
                raise InvalidArgumentError(
                    f"std of shape {tuple(torch.as_tensor(value).shape)} does not fit a parameter {shape}"
                )

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """Std · z for each parameter."""
        stds = [self.std] * len(normals) if isinstance(self.std, (int, float)) else self.std
        return [z * torch.as_tensor(std, dtype=z.dtype, device=z.device) for std, z in zip(stds, normals, strict=True)]
