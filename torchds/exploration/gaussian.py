"""Independent Gaussian noise on any parameters.

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn

from torchds.arrays import Array, broadcast_shape, real, shown
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.exploration.homogeneous import chi_mean
from torchds.exploration.shares import motion_size
from torchds.policy import GMRPolicy


class Gaussian(Exploration):
    """Independent noise of a fixed size, ε = std · z with z ~ N(0, I), for the parameters of any module.

    Args:
        std: one number for all parameters, or one number or tensor for each parameter of the group, which has to
            broadcast with it.

    Raises:
        InvalidArgumentError: a standard deviation that is negative or not finite; later, from the optimizer, one that
            does not fit its parameter.
    """

    def __init__(self, std: float | Sequence[float | Array]) -> None:
        if isinstance(std, (list, tuple)):
            values, single = [real("std", value) for value in std], False
        else:
            whole = real("std", cast(Array, std))
            values, single = ([whole], True) if whole.ndim == 0 else (list(whole), False)
        for entries in values:
            if not entries.isfinite().all() or (entries < 0).any():
                raise InvalidArgumentError(f"std has to be finite and ≥ 0, got {shown(entries.tolist())}")
        self.std: float | list[Tensor] = float(values[0]) if single else values

    @classmethod
    def relative(
        cls,
        policy: GMRPolicy,
        x0: Array,
        n_steps: int,
        dt: float,
        speed: float = 0.12,
        *,
        stiffness: float = 0.2,
        goal: Array | None = None,
    ) -> Gaussian:
        r"""One standard deviation for all entries of A and one for all of b, in shares of the motion that `policy` makes now.

        With σ = speed · mean |v| / E|z|, z a standard normal of O dimensions, and r the root mean square of |x|,

        .. math:: σ_A = σ / (\sqrt{2}\, r), \qquad σ_b = σ / \sqrt{2},

        so that the velocity noise of one expert has the mean norm `speed` times that of the motion, half of its variance
        from A and half from b; stiffness rows alike. With a goal, r is measured from it and A has all of it, σ_A = σ/r:
        that is the raw noise of `Stable`, which ties b to A.

        Args:
            policy: whose parameters are explored, all of them in one group and in their order.
            x0: `(*points, D)` the starts of the motion.
            n_steps: T.
            dt: time step [s].
            speed: the velocity noise as a share of the mean speed.
            stiffness: the noise of the stiffness as a share of the mean stiffness.
            goal: `(D,)` x*, where b is tied to it.

        Raises:
            InvalidArgumentError: see `Gaussian`; also for a policy that does not move.
        """
        size = motion_size(policy, x0, n_steps, dt, goal)
        if not size.speed > 0:
            raise InvalidArgumentError(
                f"the motion has to have a speed to explore a share of it, got {size.speed}; use Gaussian(std)"
            )
        move, stiffen = speed * size.speed / chi_mean(policy.output_dim), stiffness * size.stiffness / chi_mean(1)
        slope, offset = (1.0, 0.0) if goal is not None else (math.sqrt(0.5), math.sqrt(0.5))
        std = {
            "A": slope * move / size.distance,
            "b": offset * move,
            "stiffness_A": slope * stiffen / size.distance,
            "stiffness_b": offset * stiffen,
        }
        return cls([std[name] for name, _ in policy.named_parameters()])

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse a number or shapes of parameters that `std` does not fit."""
        if isinstance(self.std, (int, float)):
            return
        shapes = [tuple(p.shape) for p in parameters]
        if len(self.std) != len(shapes):
            raise InvalidArgumentError(f"{len(self.std)} values of std for {len(shapes)} parameters {shapes}")
        for value, shape in zip(self.std, shapes, strict=True):
            try:
                fits = broadcast_shape(torch.as_tensor(value).shape, shape) == shape
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
