"""Cartesian impedance control of a serial arm whose task lies in a plane (section 6).

Stability: stable.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol

import torch
from torch import Tensor

from torchds.arrays import Array, beside, like
from torchds.errors import InvalidArgumentError


class Chain(Protocol):
    """What is needed of an arm; `SerialChain` of pytorch-kinematics has it."""

    dtype: torch.dtype

    def jacobian(self, th: Tensor, *, ret_eef_pose: bool) -> tuple[Tensor, Tensor]:
        """Jacobians `(N, 6, J)`, linear rows first, and poses `(N, 4, 4)` of the tool in the base frame at `th` `(N, J)`."""


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


class CartesianControl(NamedTuple):
    """What the controller found and what it asks for.

    Attributes:
        torque: `(..., J)` within the limits [N m].
        x: `(..., 2)` of the tool in the plane [m].
        angle: `(...)` of the tool in the plane [rad].
        error: `(..., 6)` of the reference from the tool, base frame: position [m], then rotation vector [rad].
        saturated: `(..., J)` True where a limit cut the torque.
        nullspace: `(..., J)` the part of the torque that only moves the posture, before the limits [N m].
    """

    torque: Tensor
    x: Tensor
    angle: Tensor
    error: Tensor
    saturated: Tensor
    nullspace: Tensor


_PLANES = {"xy": (0, 1, 2, 1.0), "yz": (1, 2, 0, 1.0), "xz": (0, 2, 1, -1.0)}


class CartesianImpedance:
    r"""Springs and dampers that pull the tool of a serial arm along a reference in a plane, and torques that do so.

    With the tool's Jacobian J, mass matrix M, bias torque c and the error e of the reference,

    .. math:: \tau = J^T (K e - D (\dot x - \dot x^{ref})) + c + \tau_{null}

    in the base frame. K is diagonal: the stiffness s along the two axes of the plane and `rotation_scale`·s about its
    normal; out of the plane, where position and orientation are fixed, stiff constants.

    D damps each mode of spring and mass by `damping_ratio`, by double diagonalisation with the task inertia
    Λ = (J M⁻¹ Jᵀ)⁻¹: Λ = Q Qᵀ, K = Q K₀ Qᵀ, D = 2 ζ Q √K₀ Qᵀ (Albu-Schäffer, Ott, Frese, Hirzinger, ICRA 2003). The paper's
    2 √(s m) is this for one mass m. It is computed from the singular values of J L⁻ᵀ, M = L Lᵀ, so that Λ itself, which
    does not exist in singular postures and for arms with fewer than six joints, is not needed.

    The joints that the task leaves free are drawn to a posture by τ_null, which does not accelerate the tool:
    J M⁻¹ τ_null = 0.

    "A scaling factor of 10 for the orientation stiffness" (section 6) is read as s/10 N m/rad: 10 s would be 1500 N m/rad
    and more, several times what the real arm allows.

    Args:
        chain: of the arm, its base frame the one of all quantities here.
        posture: `(J,)` that the free joints are drawn to [rad].
        plane: of the task. Its angle turns from the first axis to the second; it is zero where the tool's own first
            axis points along the plane's (so in "xz", positive pitches the tool's x axis up).
        offset: of the plane along its normal, where the tool is held [m].
        rotation_scale: stiffness about the normal in the unit of the one along the axes [m²/rad].
        stiffness_outside: along the normal [N/m] and about the two axes of the plane [N m/rad].
        damping_ratio: ζ.
        posture_stiffness: [N m/rad].
        posture_damping: [N m s/rad].
        torque_limit: `(J,)` of the joints, both ways [N m]; None for none.

    Raises:
        InvalidArgumentError: an unknown plane, a negative gain, a limit that is not positive, sizes that do not agree.
    """

    def __init__(
        self,
        chain: Chain,
        posture: Array,
        *,
        plane: Literal["xy", "yz", "xz"] = "xz",
        offset: float = 0.0,
        rotation_scale: float = 0.1,
        stiffness_outside: tuple[float, float] = (1500.0, 100.0),
        damping_ratio: float = 1.0,
        posture_stiffness: float = 5.0,
        posture_damping: float = 2.0,
        torque_limit: Array | None = None,
    ) -> None:
        if plane not in _PLANES:
            raise InvalidArgumentError(f"plane has to be 'xy', 'yz' or 'xz', got {plane!r}")
        gains = {"rotation_scale": rotation_scale, "damping_ratio": damping_ratio}
        gains |= {"posture_stiffness": posture_stiffness, "posture_damping": posture_damping}
        gains |= dict(zip(("stiffness_outside[0]", "stiffness_outside[1]"), stiffness_outside, strict=True))
        for name, gain in gains.items():
            if not gain >= 0:
                raise InvalidArgumentError(f"{name} has to be ≥ 0, got {gain}")
        self.chain = chain
        unit = torch.empty(0, dtype=chain.dtype)
        self.posture = like("posture", posture, unit)
        n_joints = chain.jacobian(self.posture.reshape(1, -1), ret_eef_pose=True)[0].shape[-1]
        if self.posture.shape != (n_joints,):
            raise InvalidArgumentError(
                f"posture has to be ({n_joints},), one angle for each joint, got {tuple(self.posture.shape)}"
            )
        self.n_joints = n_joints
        self.torque_limit = None if torque_limit is None else like("torque_limit", torque_limit, unit)
        if self.torque_limit is not None and (
            self.torque_limit.shape != (n_joints,) or not (self.torque_limit > 0).all()
        ):
            raise InvalidArgumentError(
                f"torque_limit has to be {n_joints} positive numbers, got {self.torque_limit.tolist()}; None for no limit"
            )
        self.plane = plane
        self.offset = offset
        self.rotation_scale = rotation_scale
        self.stiffness_outside = stiffness_outside
        self.damping_ratio = damping_ratio
        self.posture_stiffness, self.posture_damping = posture_stiffness, posture_damping
        # K = fixed + share s, the diagonal; and the twists of the plane's three velocities
        first, second, normal, sign = _PLANES[plane]
        self._share, self._fixed = torch.zeros(2, 6, dtype=chain.dtype)
        self._fixed[:3], self._fixed[3:] = stiffness_outside
        self._fixed[[first, second, 3 + normal]] = 0.0
        self._share[[first, second]], self._share[3 + normal] = 1.0, rotation_scale
        self._directions = torch.zeros(3, 6, dtype=chain.dtype)
        self._directions[0, first] = self._directions[1, second] = 1.0
        self._directions[2, 3 + normal] = sign

    def __call__(
        self, q: Array, v: Array, mass: Array, bias: Array, reference: PlaneReference, stiffness: Array | float
    ) -> CartesianControl:
        """The torques in a state of the arm, for any number of arms at once.

        Args:
            q: `(..., J)` joint angles [rad].
            v: `(..., J)` joint velocities [rad/s].
            mass: `(..., J, J)` mass matrix, symmetric and positive definite [kg m²].
            bias: `(..., J)` torque of gravity, centrifugal and Coriolis forces, to compensate [N m].
            reference: its fields broadcast with the leading dimensions of `q`.
            stiffness: `(...)` s in the plane [N/m].

        Raises:
            InvalidArgumentError: another dtype than the chain's, shapes that do not agree, negative stiffness.
        """
        q = self._state_of("q", q)
        batch, n = q.shape[:-1], self.n_joints
        q, v = self._state_of("q", q, (*batch, n)), self._state_of("v", v, (*batch, n))
        mass, bias = self._state_of("mass", mass, (*batch, n, n)), self._state_of("bias", bias, (*batch, n))
        s = beside("stiffness", stiffness, q[..., 0], "a number or (...)", last=0)
        if not (s >= 0).all():
            raise InvalidArgumentError(f"stiffness has to be ≥ 0, got {s.min().item()}; clamp the policy's before")
        s = s.expand(batch)
        J, pose = self.chain.jacobian(q.reshape(-1, n), ret_eef_pose=True)
        J, pose = J.reshape(*batch, 6, n), pose.reshape(*batch, 4, 4)
        e, xdot = self._error(pose, reference), self._velocity(reference, q)
        K = self._stiffness(s)  # (..., 6), the diagonal

        # In joint coordinates scaled by the root of the mass matrix the arm has unit mass, and the task sees
        # J̃ = J L⁻ᵀ = U S Vᵀ; the rows of Vᵀ that belong to S > 0 span what the task can move.
        L = torch.linalg.cholesky(mass)
        scaled = torch.linalg.solve_triangular(L, J.mT, upper=False).mT  # (..., 6, J)
        U, S, Vh = torch.linalg.svd(scaled, full_matrices=False)
        moves = 1e-7 * S[..., :1] < S
        S, Vh = S * moves, Vh * moves.unsqueeze(-1)
        inverse = torch.where(moves, 1 / S.where(moves, torch.ones_like(S)), 0.0)
        modes = S.unsqueeze(-1) * (U.mT * K.unsqueeze(-2)) @ U * S.unsqueeze(-2)
        squares, W = torch.linalg.eigh(modes)
        root = W * squares.clamp_min(0.0).sqrt().unsqueeze(-2) @ W.mT
        slip = _times(Vh, _times(L.mT, v)) - inverse * _times(U.mT, xdot)
        damping = -2 * self.damping_ratio * _times(L, _times(Vh.mT, _times(root, slip)))

        free = self.posture_stiffness * (self.posture.to(q.device) - q) - self.posture_damping * v
        raw = torch.linalg.solve_triangular(L, free.unsqueeze(-1), upper=False).squeeze(-1)
        nullspace = _times(L, raw - _times(Vh.mT, _times(Vh, raw)))

        wanted = _times(J.mT, K * e) + damping + bias + nullspace
        limit = self.torque_limit
        torque = wanted if limit is None else wanted.clamp(-limit.to(q.device), limit.to(q.device))
        x, angle = self._state(pose)
        return CartesianControl(torque, x, angle, e, torque != wanted, nullspace)

    def _state_of(self, name: str, value: Array, shape: tuple[int, ...] | None = None) -> Tensor:
        """A quantity of the arm in the dtype of its chain; tensors have to have it already."""
        if not isinstance(value, Tensor):
            value = like(name, value, torch.empty(0, dtype=self.chain.dtype))
        if value.dtype != self.chain.dtype or (value.ndim < 1 if shape is None else value.shape != shape):
            raise InvalidArgumentError(
                f"{name} has to be {shape or '(..., J)'} in {self.chain.dtype}, as the chain is, got "
                f"{tuple(value.shape)} in {value.dtype}"
            )
        return value

    # ------------------------------------------------------------------ the plane

    def _stiffness(self, s: Tensor) -> Tensor:
        return torch.addcmul(self._fixed.to(s.device), s.unsqueeze(-1), self._share.to(s.device))

    def _state(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        first, second, _, _ = _PLANES[self.plane]
        angle = torch.atan2(pose[..., second, first], pose[..., first, first])
        return torch.stack([pose[..., first, 3], pose[..., second, 3]], -1), angle

    def _velocity(self, reference: PlaneReference, q: Tensor) -> Tensor:
        planar = torch.cat([reference.v, reference.rate.unsqueeze(-1)], -1)
        return planar @ self._directions.to(q.device)

    def _error(self, pose: Tensor, reference: PlaneReference) -> Tensor:
        """The rotation is exact up to half a turn, where the shorter way is not defined."""
        first, second, normal, _ = _PLANES[self.plane]
        position = torch.full_like(pose[..., :3, 3], self.offset)
        position[..., first], position[..., second] = reference.x[..., 0], reference.x[..., 1]
        # wanted R(angle) times the transposed orientation, row by row
        cos, sin = torch.cos(reference.angle).unsqueeze(-1), torch.sin(reference.angle).unsqueeze(-1)
        along, across = pose[..., :3, first], pose[..., :3, second]
        rows = [pose[..., :3, normal]] * 3
        rows[first], rows[second] = cos * along - sin * across, sin * along + cos * across
        turn = torch.stack(rows, -2)
        twice = torch.stack(
            [
                turn[..., 2, 1] - turn[..., 1, 2],
                turn[..., 0, 2] - turn[..., 2, 0],
                turn[..., 1, 0] - turn[..., 0, 1],
            ],
            -1,
        )
        sine = 0.5 * torch.linalg.vector_norm(twice, dim=-1, keepdim=True)
        cosine = 0.5 * (turn.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1)
        small = sine < 1e-9
        ratio = torch.where(small, 1.0, torch.atan2(sine, cosine) / sine.masked_fill(small, 1.0))
        return torch.cat([position - pose[..., :3, 3], 0.5 * twice * ratio], -1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
