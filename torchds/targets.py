"""Where the tool of an arm should be: in a plane, or as a pose in space.

Stability: stable.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torchds import poses
from torchds.arrays import Array, real
from torchds.errors import InvalidArgumentError


class PlaneReference(NamedTuple):
    """Where the tool should be in the task plane.

    Attributes:
        x: `(..., 2)` position along the plane's two axes [m].
        angle: `(...)` of the tool in the plane [rad].
        v: `(..., 2)` velocity [m/s].
        rate: `(...)` of the angle [rad/s].
    """

    x: Tensor
    angle: Tensor
    v: Tensor
    rate: Tensor


class PoseReference(NamedTuple):
    """Where the tool should be in space, in the base frame of the arm.

    Attributes:
        x: `(..., 3)` position [m].
        rotation: `(..., 3, 3)` from the frame of the tool to the base frame.
        v: `(..., 3)` velocity [m/s].
        rate: `(..., 3)` angular velocity [rad/s].
    """

    x: Tensor
    rotation: Tensor
    v: Tensor
    rate: Tensor

    @classmethod
    def of(cls, x: Array, v: Array, goal: Array, *, order: poses.Order = "wxyz") -> PoseReference:
        """A state of a motion of poses, see `torchds.poses`.

        Args:
            x: `(..., 6)` [p, r].
            v: `(..., 6)` its velocity, as the policy gives it.
            goal: `(4,)` orientation at which r is zero.
            order: where its scalar stands.
        """
        x, v = real("x", x, "(..., D)"), real("v", v, "(..., D)")
        rate = poses.angular_velocity(x, v, goal, order=order)
        return cls(x[..., :3], poses.matrix(x, goal, order=order), v[..., :3], rate)


Reference = PlaneReference | PoseReference

_PLANES = {"xy": (0, 1, 2, 1.0), "yz": (1, 2, 0, 1.0), "xz": (0, 2, 1, -1.0)}


class Plane:
    """The plane of a task, for the tensors of `CartesianImpedance`.

    Args:
        name: its axes, the angle turns from the first to the second.
        offset: along the normal [m].

    Attributes:
        first, second, normal: which axes of the base frame these are.
        sign: of a turn about the normal that turns the first axis to the second.

    Raises:
        InvalidArgumentError: an unknown plane.
    """

    def __init__(self, name: Literal["xy", "yz", "xz"], offset: float) -> None:
        if name not in _PLANES:
            raise InvalidArgumentError(f"plane has to be 'xy', 'yz' or 'xz', got {name!r}")
        self.first, self.second, self.normal, self.sign = _PLANES[name]
        self.offset = offset
        one, other, out = torch.eye(3, dtype=torch.float64)[[self.first, self.second, self.normal]]
        self._parts = (
            torch.stack([one, other]),
            self.sign * out,
            torch.outer(one, one) + torch.outer(other, other),
            torch.outer(other, one) - torch.outer(one, other),
            torch.outer(out, out),
            offset * out,
        )

    def state(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Position `(..., 2)` [m] and angle `(...)` [rad] of poses `(..., 4, 4)`."""
        angle = torch.atan2(pose[..., self.second, self.first], pose[..., self.first, self.first])
        return torch.stack([pose[..., self.first, 3], pose[..., self.second, 3]], -1), angle

    def pose(self, reference: PlaneReference) -> PoseReference:
        """The same reference in space."""
        x, angle = reference.x, reference.angle
        along, about, level, quarter, fixed, lifted = (part.to(x) for part in self._parts)
        cos, sin = torch.cos(angle)[..., None, None], torch.sin(angle)[..., None, None]
        rotation = torch.addcmul(torch.addcmul(fixed, cos, level), sin, quarter)
        return PoseReference(x @ along + lifted, rotation, reference.v @ along, reference.rate.unsqueeze(-1) * about)

    def turn(self, pose: Tensor, reference: PlaneReference) -> Tensor:
        """The wanted orientation times the transposed one of the tool `(..., 3, 3)`, row by row."""
        cos, sin = torch.cos(reference.angle).unsqueeze(-1), torch.sin(reference.angle).unsqueeze(-1)
        along, across = pose[..., :3, self.first], pose[..., :3, self.second]
        rows = [pose[..., :3, self.normal]] * 3
        rows[self.first], rows[self.second] = cos * along - sin * across, sin * along + cos * across
        return torch.stack(rows, -2)
