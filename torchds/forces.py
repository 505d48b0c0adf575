"""External forces on a plant. A force is any function of time, position and velocity; here, three.

Stability: stable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchds.arrays import Array, beside, number, real
from torchds.devices import Movable
from torchds.errors import InvalidArgumentError
from torchds.kernels.steps import AWAY, AWAY_ALONG_NORMAL, BEYOND, CONSTANT, ScalarStep


@dataclass(frozen=True)
class ConstantForce(Movable):
    """The same force everywhere, or beyond a border only.

    Args:
        force: `(D,)`, `(*points, D)` or `(*batch, *points, D)` [N].
        border: it acts where the coordinate `axis` of the position is larger than this; None for everywhere.
        axis: of the border.
    """

    force: Tensor
    border: float | None = None
    axis: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", real("force", self.force, "(*batch, *points, D)"))
        D = self.force.shape[-1]
        if self.border is not None and self.axis not in range(-D, D):
            raise InvalidArgumentError(
                f"axis has to be one of the {D} of the force, from {-D} to {D - 1}, got {self.axis!r}"
            )

    def __call__(self, t: float, x: Tensor, v: Tensor) -> Tensor:
        """The force at positions `x` `(..., D)`."""
        force = beside("force", self.force, x, "(*batch, *points, D)")
        return force if self.border is None else torch.where(x[..., self.axis, None] > self.border, force, 0.0)

    def scalar_step(self, n_axes: int, n_rows: int) -> ScalarStep | None:
        """The same for compiled code."""
        if type(self) is not ConstantForce:
            return None
        _check_axes("force", self.force, n_axes)
        if self.border is None:
            return ScalarStep(CONSTANT, self.force)
        force = self.force.double()  # the border is a number of Python
        where = force.new_tensor([self.border, self.axis % n_axes]).expand(*force.shape[:-1], 2)
        return ScalarStep(BEYOND, torch.cat([where, force], -1))


@dataclass(frozen=True)
class SpringForce(Movable):
    """A spring to one point, without length at rest: a hand that pulls.

    Args:
        anchor: `(D,)`, `(*points, D)` or `(*batch, *points, D)`, where it is held.
        stiffness: [N/m].
    """

    anchor: Tensor
    stiffness: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "anchor", real("anchor", self.anchor, "(*batch, *points, D)"))
        number("stiffness", self.stiffness, "finite and at least 0", lambda k: 0 <= k < math.inf)

    def __call__(self, t: float, x: Tensor, v: Tensor) -> Tensor:
        """The force at positions `x` `(..., D)`."""
        force: Tensor = self.stiffness * (beside("anchor", self.anchor, x, "(*batch, *points, D)") - x)
        return force


class DivergentForce(Movable):
    """A force away from the nearest point of a path, as large as the distance from it times a gain.

    Args:
        path: `(n, D)` points of the path.
        gain: [N/m].
        along_normal: whether it points along the normal of the path's segment at the nearest point, to the side where the
            position is, rather than straight away from that point; in the plane, where points that repeat are left out.
    """

    def __init__(self, path: Array, gain: float, *, along_normal: bool = False) -> None:
        path = real("path", path)
        if path.ndim != 2 or len(path) < 2:
            raise InvalidArgumentError(f"path has to be (n, D) of at least two points, got shape {tuple(path.shape)}")
        if along_normal:
            path = path[torch.cat([path.new_ones(1, dtype=torch.bool), path.diff(dim=0).any(-1)])]
            if len(path) < 2 or path.shape[-1] != 2:
                raise InvalidArgumentError(
                    f"a path with normals has to be (n, 2) of at least two different points, got {tuple(path.shape)} of them"
                )
        self.path, self.gain, self.along_normal = path, number("gain", gain, "finite", math.isfinite), along_normal
        self.normal = torch.zeros_like(path)  # (n, D)
        if along_normal:
            tangent = torch.cat([path.diff(dim=0), path[-1:] - path[-2:-1]])
            normal = torch.stack([-tangent[:, 1], tangent[:, 0]], -1)
            self.normal = normal / normal.norm(dim=-1, keepdim=True)

    def __call__(self, t: float, x: Tensor, v: Tensor) -> Tensor:
        """The force at positions `x` `(..., D)`."""
        _check_axes("path", self.path, x.shape[-1])
        path = self.path.to(x)
        nearest = (path.square().sum(-1) - 2 * x.detach() @ path.mT).argmin(-1)
        offset = x - path[nearest]
        if not self.along_normal:
            return self.gain * offset
        n = self.normal.to(x)[nearest]
        distance = torch.linalg.vector_norm(offset, dim=-1, keepdim=True)
        force: Tensor = self.gain * distance * torch.sign((n * offset).sum(-1, keepdim=True)) * n
        return force

    def scalar_step(self, n_axes: int, n_rows: int) -> ScalarStep | None:
        """The same for compiled code."""
        if type(self) is not DivergentForce:
            return None
        _check_axes("path", self.path, n_axes)
        path = self.path.double()  # the gain is a number of Python
        parts = [path.new_tensor([self.gain]), path.flatten(), path.square().sum(-1), self.normal.double().flatten()]
        return ScalarStep(AWAY_ALONG_NORMAL if self.along_normal else AWAY, torch.cat(parts))


def _check_axes(name: str, value: Tensor, n_axes: int) -> None:
    if value.shape[-1] != n_axes:
        raise InvalidArgumentError(
            f"{name} has to have the {n_axes} axes of the motion, got shape {tuple(value.shape)}"
        )
