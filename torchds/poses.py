r"""Orientation: poses as vectors, in which a motion is learned like any other.

With the orientation q* at the goal, an orientation q is the rotation vector r = 2 log(q*⁻¹ q) in the frame of the goal: its
direction is the axis, its length the angle. The state of a pose is [p, r], and r = 0 is the goal. The chart reaches up to an
angle of π; the quaternions q and −q are the same orientation and the same r. Motions of r need no unit norm to be kept, and a
system that is stable in [p, r] ends at the goal's pose.

Quaternions are `(..., 4)` of any norm above zero, the scalar first (MuJoCo); `order="xyzw"` has it last (ROS, scipy).

Stability: stable.

Example:
    >>> import torch, torchds
    >>> t = torch.linspace(0, 1, 50, dtype=torch.float64)[:, None]
    >>> q = torch.cat([torch.cos(t / 2), torch.sin(t / 2), 0 * t, 0 * t], -1)  # one radian about x in a second
    >>> goal = torchds.poses.last_orientation([q])
    >>> demos = torchds.poses.from_poses([torch.cat([t, t, t], -1)], [q], dt=1 / 49)
    >>> torch.allclose(torchds.poses.quaternion(demos[0].x, goal), q)
    True
    >>> torchds.poses.angular_velocity(demos[0].x[20], demos[0].v[20], goal).round(decimals=6)
    tensor([1., 0., 0.], dtype=torch.float64)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, get_args

import torch
from torch import Tensor

from torchds.arrays import Array, beside, matching, real, tensor, tensors
from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError, InvalidDemonstrationsError, UnknownNameError

Order = Literal["wxyz", "xyzw"]
NAMES = ("x", "y", "z", "rx", "ry", "rz")
ROUNDED = 1e-3  # [rad] that an angle may be beyond π, and that the norm of a recorded quaternion may be off


def from_poses(
    position: Sequence[Array] | Tensor,
    quaternion: Sequence[Array] | Tensor,
    dt: float | Sequence[float],
    goal: Array | None = None,
    *,
    order: Order = "wxyz",
    units: str = "m",
) -> Demonstrations:
    """Demonstrations over [p, r], names x, y, z, rx, ry, rz, from recorded poses.

    Args:
        position: `(T, 3)` of each demonstration.
        quaternion: `(T, 4)` of each demonstration, with signs as they come.
        dt: time step [s], one for all or one for each.
        goal: `(4,)` the orientation q* at which r is zero; `last_orientation(quaternion)` by default.
        order: where the scalar of a quaternion stands, in `goal` too.
        units: of positions; r is in radians.

    Raises:
        InvalidDemonstrationsError: shapes that do not fit, quaternions whose norm is not 1, or a motion that is further than π
            from the goal.
        InvalidArgumentError: a goal that is no quaternion.
    """
    p = tensors("position", position)
    q = [_scalar_first(value, order) for value in matching("quaternion", quaternion, p)]
    if p[0].shape[-1] != 3 or q[0].shape[-1] != 4:
        raise InvalidDemonstrationsError(
            f"position has to have 3 columns and quaternion 4, got {p[0].shape[-1]} and {q[0].shape[-1]}"
        )
    for i, value in enumerate(q):
        error = (torch.linalg.vector_norm(value, dim=-1) - 1).abs()
        if not bool((error < ROUNDED).all()):
            row = int((~(error < ROUNDED)).int().argmax())
            raise InvalidDemonstrationsError(
                f"demonstration {i}, row {row}: a quaternion has to have norm 1, got {value[row].tolist()}"
            )
    star = last_orientation(q) if goal is None else _scalar_first(tensor("goal", goal), order)
    r = [_continuous(i, value, star) for i, value in enumerate(q)]
    return Demonstrations(
        [torch.cat(parts, -1) for parts in zip(p, r, strict=True)],
        dt=dt,
        names=NAMES,
        units=(units,) * 3 + ("rad",) * 3,
    )


def last_orientation(quaternion: Sequence[Array] | Tensor, *, order: Order = "wxyz") -> Tensor:
    """`(4,)` the mean orientation at the ends of some motions, the default goal of `from_poses`, in the same order.

    Args:
        quaternion: `(T, 4)` of each motion.
        order: where the scalar stands.
    """
    ends = torch.stack([_scalar_first(value[-1], order) for value in tensors("quaternion", quaternion)])
    ends = _unit(ends)
    mean: Tensor = torch.linalg.eigh(ends.mT @ ends).eigenvectors[:, -1]  # the largest Σ (q·qᵢ)², whatever the signs
    return _in_order(_upper(mean), order)


def rotation_vector(quaternion: Array, goal: Array, *, order: Order = "wxyz") -> Tensor:
    """r `(..., 3)` of orientations `(..., 4)` in the frame of the goal [rad], of length at most π.

    Args:
        quaternion: `(..., 4)`.
        goal: `(4,)` or `(..., 4)`.
        order: where the scalar of both stands.
    """
    q = _unit(_scalar_first(real("quaternion", quaternion), order))
    return _logarithm(_upper(_relative(q, _goal(goal, q, order))))


def quaternion(x: Array, goal: Array, *, order: Order = "wxyz") -> Tensor:
    """The unit quaternion `(..., 4)` of a state.

    Args:
        x: `(..., D)`, whose last three are r.
        goal: `(4,)` or `(..., 4)`.
        order: where the scalar of both stands.
    """
    r = _rotation_part("x", x)
    angle = torch.linalg.vector_norm(r, dim=-1, keepdim=True)
    turned = torch.cat([torch.cos(angle / 2), 0.5 * torch.sinc(angle / (2 * math.pi)) * r], -1)
    return _in_order(_product(_goal(goal, turned, order), turned), order)


def matrix(x: Array, goal: Array, *, order: Order = "wxyz") -> Tensor:
    """The rotation matrix `(..., 3, 3)` of a state, from the frame of the tool to the base frame.

    Args:
        x: `(..., D)`, whose last three are r.
        goal: `(4,)` or `(..., 4)`.
        order: where the scalar of `goal` stands.
    """
    q = _scalar_first(quaternion(x, goal, order=order), order).unsqueeze(-2)
    return _rotated(q, torch.eye(3, dtype=q.dtype, device=q.device)).mT


def angular_velocity(x: Array, v: Array, goal: Array, *, order: Order = "wxyz") -> Tensor:
    r"""ω `(..., 3)` in the base frame [rad/s], exactly that of a motion in r.

    .. math:: ω = R^* \left(\dot r + \frac{1-\cos θ}{θ^2} r × \dot r + \frac{θ-\sin θ}{θ^3} r × (r × \dot r)\right)

    with θ = |r|.

    Args:
        x: `(..., D)`, whose last three are r.
        v: `(..., D)`, whose last three are ṙ.
        goal: `(4,)` or `(..., 4)`.
        order: where the scalar of `goal` stands.
    """
    r = _rotation_part("x", x)
    rate = beside("v", _rotation_part("v", v), r, "(..., D)")
    θ = torch.linalg.vector_norm(r, dim=-1, keepdim=True)
    once = _cross(r, rate)
    near = θ < 0.3  # where θ − sin θ loses digits, its series has them all
    far = torch.where(near, torch.ones_like(θ), θ)
    s = θ.square()
    series = 1 / 6 - s / 120 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110)))
    second = torch.where(near, series, (far - torch.sin(far)) / far**3)
    ω = rate + 0.5 * torch.sinc(θ / (2 * math.pi)).square() * once + second * _cross(r, once)
    return _rotated(_goal(goal, torch.cat([ω, θ], -1), order), ω)


# ------------------------------------------------------------------ quaternions, the scalar first


def _continuous(i: int, q: Tensor, goal: Tensor) -> Tensor:
    """r `(T, 3)` along a motion `(T, 4)`, followed backwards from its end, so that no sign of a quaternion matters."""
    relative = _relative(q, goal)
    same = (relative[1:] * relative[:-1]).sum(-1) >= 0
    signs = torch.where(same, 1.0, -1.0).to(q).flip(0).cumprod(0).flip(0)
    last = _upper(relative[-1])
    r = _logarithm(torch.cat([signs.unsqueeze(-1) * relative[:-1] * _sign_of(relative[-1]), last[None]]))
    angle = torch.linalg.vector_norm(r, dim=-1)
    if float(angle.max()) > math.pi + ROUNDED:
        row = int(angle.argmax())
        raise InvalidDemonstrationsError(
            f"demonstration {i}, row {row}: it is {math.degrees(float(angle[row])):.0f}° away from its goal, which has to be "
            "at most 180°; split the motion, or give a goal= between"
        )
    return r


def _logarithm(q: Tensor) -> Tensor:
    """The rotation vector of unit quaternions, of a length up to 2π for a scalar below zero."""
    w, vector = q[..., :1], q[..., 1:]
    sine = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    tiny = sine == 0
    safe = torch.where(tiny, torch.ones_like(sine), sine)
    return torch.where(tiny, 2 * torch.ones_like(sine), 2 * torch.atan2(safe, w) / safe) * vector


def _relative(q: Tensor, goal: Tensor) -> Tensor:
    """q*⁻¹ q of unit norm."""
    conjugate = _unit(goal) * goal.new_tensor([1.0, -1.0, -1.0, -1.0])
    return _product(conjugate, _unit(q.to(conjugate)))


def _product(a: Tensor, b: Tensor) -> Tensor:
    """The product of quaternions."""
    a0, a1, b0, b1 = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    scalar = a0 * b0 - (a1 * b1).sum(-1, keepdim=True)
    return torch.cat([scalar, a0 * b1 + b0 * a1 + _cross(a1, b1)], -1)


def _rotated(q: Tensor, vector: Tensor) -> Tensor:
    """R(q) v."""
    twice: Tensor = 2 * _cross(q[..., 1:], vector)
    return vector + q[..., :1] * twice + _cross(q[..., 1:], twice)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """a × b; that of torch does not broadcast."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def _upper(q: Tensor) -> Tensor:
    """That of q and −q whose first number that is not zero is positive."""
    return q * _sign_of(q)


def _sign_of(q: Tensor) -> Tensor:
    first = (q != 0).int().argmax(-1, keepdim=True)
    return torch.where(q.gather(-1, first) < 0, -1.0, 1.0).to(q)


def _unit(q: Tensor) -> Tensor:
    if q.shape[-1:] != (4,):
        raise InvalidArgumentError(f"a quaternion has to have 4 numbers in its last axis, got shape {tuple(q.shape)}")
    norm: Tensor = torch.linalg.vector_norm(q, dim=-1, keepdim=True)
    if not bool((norm > 0).all()):
        raise InvalidArgumentError("a quaternion has to have a norm above zero; is a row empty?")
    return q / norm


def _goal(goal: Array, q: Tensor, order: Order) -> Tensor:
    """q* of unit norm, the scalar first, for orientations or what has their shape `(..., 4)`."""
    return _unit(_scalar_first(beside("goal", goal, q, "(4,) or (..., 4)"), order))


def _rotation_part(name: str, x: Array) -> Tensor:
    x = real(name, x, "(..., D)")
    if x.shape[-1] < 3:
        raise InvalidArgumentError(f"{name} has to end with the three of the rotation, got shape {tuple(x.shape)}")
    return x[..., -3:]


def _scalar_first(q: Tensor, order: Order) -> Tensor:
    if order not in get_args(Order):
        raise UnknownNameError("order", order, get_args(Order))
    if order == "wxyz" or q.shape[-1:] != (4,):  # other shapes are refused by who takes them
        return q
    return q[..., [3, 0, 1, 2]]


def _in_order(q: Tensor, order: Order) -> Tensor:
    return q if order == "wxyz" else q[..., [1, 2, 3, 0]]
