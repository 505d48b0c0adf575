"""Where the tool of a serial arm is, and how it moves with the joints.

Stability: experimental.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from torchds.arrays import Array, tensor
from torchds.devices import Movable
from torchds.errors import InvalidArgumentError


class Chain(Protocol):
    """What is needed of an arm; `Screws` has it, and `SerialChain` of pytorch-kinematics."""

    @property
    def dtype(self) -> torch.dtype:
        """Of all angles and poses."""

    def jacobian(self, th: Tensor, *, ret_eef_pose: bool) -> tuple[Tensor, Tensor]:
        """Jacobians `(N, 6, J)`, linear rows first, and poses `(N, 4, 4)` of the tool in the base frame at `th` `(N, J)`."""


class Screws(Movable):
    r"""An arm as a product of exponentials, :math:`T(q) = e^{S_1 q_1} \cdots e^{S_J q_J} M` (Brockett 1984).

    Args:
        axes: `(6, J)` the screw of each joint at q = 0, in the base frame: the velocity of the point that passes through the
            origin, then the angular velocity, for a joint that moves by one.
        home: `(4, 4)` pose of the tool at q = 0.

    Raises:
        InvalidArgumentError: shapes that are none of these, or an axis of rotation that has no unit length.

    Example:
        >>> import torch
        >>> axes = torch.tensor([[0.0, 0, 0, 0, 0, 1]]).T  # one joint about z
        >>> home = torch.eye(4)
        >>> home[0, 3] = 2.0  # the tool two metres out along x
        >>> J, pose = Screws(axes, home).jacobian(torch.zeros(1, 1))
        >>> J[0, :, 0]
        tensor([0., 2., 0., 0., 0., 1.])
    """

    def __init__(self, axes: Array, home: Array) -> None:
        self.axes, self.home = tensor("axes", axes), tensor("home", home)
        if self.axes.ndim != 2 or len(self.axes) != 6 or self.home.shape != (4, 4):
            raise InvalidArgumentError(
                f"axes have to be (6, J) and home (4, 4), got {tuple(self.axes.shape)} and {tuple(self.home.shape)}"
            )
        length = torch.linalg.vector_norm(self.axes[3:], dim=0)
        if not bool(((length == 0) | ((length - 1).abs() < 1e-6)).all()):
            raise InvalidArgumentError(
                f"an axis of rotation has to have length 1, or 0 for a joint that slides, got {length.tolist()}"
            )
        self.axes = self.axes / torch.where(length > 0, length, torch.ones_like(length))

    @property
    def dtype(self) -> torch.dtype:
        """Of all angles and poses."""
        return self.home.dtype

    @classmethod
    def of(cls, chain: Chain, n_joints: int) -> Screws | None:
        """The screws of any arm, from its Jacobian at q = 0; None where it is no arm of turning and sliding joints."""
        zero = torch.zeros(1, n_joints, dtype=chain.dtype)
        J, home = (value[0] for value in chain.jacobian(zero, ret_eef_pose=True))
        try:
            screws = cls(torch.cat([J[:3] - torch.linalg.cross(J[3:], home[:3, 3:], dim=0), J[3:]]), home)
        except InvalidArgumentError:
            return None
        q = torch.linspace(-1, 1, 3 * n_joints, dtype=chain.dtype).reshape(3, n_joints)
        pairs = zip(chain.jacobian(q, ret_eef_pose=True), screws.jacobian(q), strict=True)
        close = 1e-3 if chain.dtype == torch.float32 else 1e-5
        return screws if all(torch.allclose(a, b, atol=close, rtol=0) for a, b in pairs) else None

    def jacobian(self, th: Tensor, *, ret_eef_pose: bool = True) -> tuple[Tensor, Tensor]:
        """See `Chain.jacobian`."""
        if th.ndim != 2 or th.shape[1] != self.axes.shape[1]:
            raise InvalidArgumentError(
                f"joint angles have to be (N, {self.axes.shape[1]}), one for each joint, got {tuple(th.shape)}"
            )
        v, ω = self.axes[:3].mT, self.axes[3:].mT  # (J, 3)
        W = _hat(ω)
        WW, eye = W @ W, torch.eye(3, dtype=self.dtype, device=self.home.device)
        θ = th[..., None, None]
        sine, versed = torch.sin(θ), 1 - torch.cos(θ)
        R = eye + sine * W + versed * WW  # (N, J, 3, 3)
        p = ((θ * eye + versed * W + (θ - sine) * WW) @ v.unsqueeze(-1)).squeeze(-1)
        turned, moved = eye.expand(len(th), 3, 3), torch.zeros_like(p[:, 0])
        columns = []
        for j in range(th.shape[-1]):
            axis = turned @ ω[j]
            columns.append(torch.cat([turned @ v[j] + torch.linalg.cross(moved, axis), axis], -1))
            moved = moved + (turned @ p[:, j].unsqueeze(-1)).squeeze(-1)
            turned = turned @ R[:, j]
        pose = torch.cat([turned, moved.unsqueeze(-1)], -1) @ self.home
        pose = torch.cat([pose, self.home[3:].expand(len(th), 1, 4)], -2)
        J = torch.stack(columns, -1)
        linear = J[:, :3] + torch.linalg.cross(J[:, 3:], pose[:, :3, 3:].expand_as(J[:, 3:]), dim=1)
        return torch.cat([linear, J[:, 3:]], 1), pose


def with_tool(J: Tensor, pose: Tensor, tool: Tensor) -> tuple[Tensor, Tensor]:
    """Jacobians and poses of a tool that is fixed to the end of the arm.

    Args:
        J: `(..., 6, J)` of the end.
        pose: `(..., 4, 4)` of the end.
        tool: `(4, 4)` pose in the frame of the end.
    """
    arm = (pose[..., :3, :3] @ tool[:3, 3]).unsqueeze(-1)
    linear = J[..., :3, :] + torch.linalg.cross(J[..., 3:, :], arm.expand_as(J[..., 3:, :]), dim=-2)
    return torch.cat([linear, J[..., 3:, :]], -2), pose @ tool


def _hat(ω: Tensor) -> Tensor:
    """The matrices `(..., 3, 3)` of ω ×."""
    x, y, z = ω.unbind(-1)
    zero = torch.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
