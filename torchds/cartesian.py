"""Cartesian impedance control of a serial arm, in a plane (section 6) or in space.

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torchds.arm_law import Gains, State, rotation_vector, torques
from torchds.arrays import Array, beside, like
from torchds.errors import InvalidArgumentError
from torchds.kernels.choice import Backend, has, wanted
from torchds.kinematics import Chain, Screws, with_tool
from torchds.targets import Plane, PlaneReference, PoseReference, Reference


class CartesianControl(NamedTuple):
    """What the controller found and what it asks for.

    Attributes:
        torque: `(..., J)` within the limits [N m].
        pose: `(..., 4, 4)` of the tool in the base frame; `CartesianImpedance.in_plane` reads it.
        error: `(..., 6)` of the reference from the tool, base frame: position [m], then rotation vector [rad].
        saturated: `(..., J)` True where a limit cut the torque.
        nullspace: `(..., J)` the part of the torque that only moves the posture, before the limits [N m].
    """

    torque: Tensor
    pose: Tensor
    error: Tensor
    saturated: Tensor
    nullspace: Tensor


class CartesianImpedance:
    r"""Springs and dampers that pull the tool of a serial arm along a reference, and torques that do so.

    With the tool's Jacobian J, mass matrix M, bias torque c and the error e of the reference,

    .. math:: \tau = J^T (K e - D (\dot x - \dot x^{ref})) + c + \tau_{null}

    in the base frame. K is diagonal. For a `PlaneReference` it has the stiffness s along the two axes of the plane and
    `rotation_scale`·s about its normal; out of the plane, where position and orientation are fixed, stiff constants. For a
    `PoseReference` it has s along all axes and `rotation_scale`·s about them.

    D damps each mode of spring and mass by `damping_ratio`, by double diagonalisation with the task inertia
    Λ = (J M⁻¹ Jᵀ)⁻¹: Λ = Q Qᵀ, K = Q K₀ Qᵀ, D = 2 ζ Q √K₀ Qᵀ (Albu-Schäffer, Ott, Frese, Hirzinger, ICRA 2003). The paper's
    2 √(s m) is this for one mass m. In singular postures and for arms with fewer than six joints, where there is no Λ, it is
    D = 2 ζ √K ((√K J M⁻¹ Jᵀ √K)^½)⁺ √K, elsewhere the same; it is computed from the singular values of √K J L⁻ᵀ, M = L Lᵀ.

    The joints that the task leaves free are drawn to a posture by τ_null, which does not accelerate the tool:
    J M⁻¹ τ_null = 0.

    "A scaling factor of 10 for the orientation stiffness" (section 6) is read as s/10 N m/rad: 10 s would be 1500 N m/rad
    and more, several times what the real arm allows.

    Args:
        chain: of the arm, its base frame the one of all quantities here: `torchds.impedance.arm(path).chain`, or one of
            pytorch-kinematics.
        posture: `(J,)` that the free joints are drawn to [rad].
        tool: `(4, 4)` pose of the tool in the frame of the chain's end, where it is another: a point further out, axes that
            the references mean. `aligned` finds the axes.
        plane: of the task. Its angle turns from the first axis to the second; it is zero where the tool's own first
            axis points along the plane's (so in "xz", positive pitches the tool's x axis up).
        offset: of the plane along its normal, where the tool is held [m].
        rotation_scale: stiffness about the normal in the unit of the one along the axes [m²/rad].
        stiffness_outside: along the normal [N/m] and about the two axes of the plane [N m/rad].
        damping_ratio: ζ.
        posture_stiffness: [N m/rad].
        posture_damping: [N m s/rad].
        torque_limit: `(J,)` of the joints, both ways [N m]; None for none.
        start_within: distance [m] and angle [rad] from its reference within which the tool has to be at the first call, since
            springs pull it there at once; after `reset` the next call is the first. None to let it begin anywhere.
        backend: "fused" for compiled code (extra "fast", float64 on the CPU, without gradients), "eager" for torch, "auto" for
            the first where it can be. They agree to round-off.

    Raises:
        InvalidArgumentError: an unknown plane, a negative gain, a limit that is not positive, sizes that do not agree, a tool
            that is no pose, or a fused backend that cannot be.
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
        tool: Array | None = None,
        start_within: tuple[float, float] | None = (0.1, math.radians(30)),
        backend: Backend = "auto",
    ) -> None:
        self.plane = Plane(plane, offset)
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
        self.tool = None if tool is None else like("tool", tool, unit)
        if self.tool is not None and not _is_pose(self.tool):
            raise InvalidArgumentError(f"tool has to be a pose (4, 4) with a rotation, got {self.tool.tolist()}")
        self.start_within, self._started = start_within, False
        self.gains = Gains(self.posture, damping_ratio, posture_stiffness, posture_damping)
        # K = fixed + share s, the diagonal
        share, fixed = torch.zeros(2, 6, dtype=chain.dtype)
        fixed[:3], fixed[3:] = stiffness_outside
        fixed[[self.plane.first, self.plane.second, 3 + self.plane.normal]] = 0.0
        share[[self.plane.first, self.plane.second]], share[3 + self.plane.normal] = 1.0, rotation_scale
        everywhere = torch.ones_like(share)
        everywhere[3:] = rotation_scale
        self._stiffness = {PlaneReference: (fixed, share), PoseReference: (torch.zeros_like(share), everywhere)}
        self._fused = self._fuse(backend)

    def _fuse(self, backend: Backend) -> Callable[[State, Reference, Tensor], CartesianControl] | None:
        """The compiled law; None where torch has to do.

        Raises:
            InvalidArgumentError: "fused" where it cannot be.
        """
        chosen, screws = wanted(backend), None
        if chosen in ("auto", "fused") and has("cpu") and self.chain.dtype == torch.float64:
            screws = Screws.of(self.chain, self.n_joints)
        if screws is None:
            if backend == "fused":
                raise InvalidArgumentError(
                    "backend='fused' needs numba (pip install 'torchds[fast]') and a chain of joints that turn or slide, in "
                    f"float64, got one in {self.chain.dtype}; backend='auto' takes torch where that is not so"
                )
            return None
        from torchds.fused_arm import FusedArm

        home = screws.home if self.tool is None else screws.home @ self.tool
        made = FusedArm(Screws(screws.axes, home), self.plane, self.gains, self.torque_limit)

        def law(state: State, reference: Reference, s: Tensor) -> CartesianControl:
            return CartesianControl(*made(state, reference, s, self._stiffness[type(reference)]))

        return law

    def __call__(
        self, q: Array, v: Array, mass: Array, bias: Array, reference: Reference, stiffness: Array | float
    ) -> CartesianControl:
        """The torques in a state of the arm, for any number of arms at once.

        Args:
            q: `(..., J)` joint angles [rad].
            v: `(..., J)` joint velocities [rad/s].
            mass: `(..., J, J)` mass matrix, symmetric and positive definite [kg m²].
            bias: `(..., J)` torque of gravity, centrifugal and Coriolis forces, to compensate [N m].
            reference: its fields broadcast with the leading dimensions of `q`.
            stiffness: `(...)` s [N/m].

        Raises:
            InvalidArgumentError: another dtype than the chain's, shapes that do not agree, negative stiffness, or a tool that
                begins too far from its reference.
        """
        q = self._state_of("q", q)
        batch, n = q.shape[:-1], self.n_joints
        q, v = self._state_of("q", q, (*batch, n)), self._state_of("v", v, (*batch, n))
        mass, bias = self._state_of("mass", mass, (*batch, n, n)), self._state_of("bias", bias, (*batch, n))
        s = beside("stiffness", stiffness, q[..., 0], "a number or (...)", last=0)
        if not (s >= 0).all():
            raise InvalidArgumentError(f"stiffness has to be ≥ 0, got {s.min().item()}; clamp the policy's before")
        s = s.expand(batch)
        state = State(q, v, mass, bias)
        made = self._fused if self._fused is not None and _plain(*state, *reference, s) else self._eager
        asked = made(state, reference, s)
        self._begin(asked.error)
        return asked

    def reset(self) -> None:
        """The next call is the first of another motion."""
        self._started = False

    def in_plane(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Position `(..., 2)` [m] and angle `(...)` [rad] of the tool in the task plane, from its pose `(..., 4, 4)`."""
        return self.plane.state(pose)

    def aligned(self, q: Array, reference: Reference) -> Tensor:
        """The tool `(4, 4)` that is this one with the axes that the reference means, where the arm stands.

        Args:
            q: `(J,)` joint angles in which the tool is held as the reference says [rad].
            reference: of one arm.
        """
        _, pose = self.chain.jacobian(self._state_of("q", q, (self.n_joints,)).unsqueeze(0), ret_eef_pose=True)
        tool = torch.eye(4, dtype=self.chain.dtype) if self.tool is None else self.tool.clone()
        tool[:3, :3] = pose[0, :3, :3].mT @ self._in_space(reference).rotation
        return tool

    def _in_space(self, reference: Reference) -> PoseReference:
        return reference if isinstance(reference, PoseReference) else self.plane.pose(reference)

    def _eager(self, state: State, reference: Reference, s: Tensor) -> CartesianControl:
        q, batch = state.q, state.q.shape[:-1]
        J, pose = self.chain.jacobian(q.reshape(-1, self.n_joints), ret_eef_pose=True)
        if self.tool is not None:
            J, pose = with_tool(J, pose, self.tool.to(q.device))
        J, pose = J.reshape(*batch, 6, self.n_joints), pose.reshape(*batch, 4, 4)
        x, rotation, v, rate = self._in_space(reference)
        turn = rotation @ pose[..., :3, :3].mT
        if isinstance(reference, PlaneReference):
            turn = self.plane.turn(pose, reference)  # the same without products with zero
        error = torch.cat([x - pose[..., :3, 3], rotation_vector(turn)], -1)
        fixed, share = (part.to(q.device) for part in self._stiffness[type(reference)])
        K = torch.addcmul(fixed, s.unsqueeze(-1), share)
        wanted, nullspace = torques(state, self.gains, J, K, error, torch.cat([v, rate], -1))
        limit = self.torque_limit
        torque = wanted if limit is None else wanted.clamp(-limit.to(q.device), limit.to(q.device))
        return CartesianControl(torque, pose, error, torque != wanted, nullspace)

    def _begin(self, error: Tensor) -> None:
        """Refuse a first call too far from the reference.

        Raises:
            InvalidArgumentError: by how much, and what to do.
        """
        if self._started or self.start_within is None:
            return
        distance, angle = (
            float(torch.linalg.vector_norm(part, dim=-1).max())
            for part in (error[..., :3].detach(), error[..., 3:].detach())
        )
        near, little = self.start_within
        if not (distance <= near and angle <= little):  # nor NaN
            raise InvalidArgumentError(
                f"the tool begins {distance:.3g} m and {math.degrees(angle):.3g}° from its reference, at most {near:.3g} m and "
                f"{math.degrees(little):.3g}° are allowed; bring it there first, give the tool that the reference means "
                "(tool=control.aligned(q, reference) has its axes), or start_within=None to have it pulled there"
            )
        self._started = True

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


def _is_pose(tool: Tensor) -> bool:
    if tool.shape != (4, 4) or tool[3].tolist() != [0, 0, 0, 1]:
        return False
    rotation, eye = tool[:3, :3], torch.eye(3, dtype=tool.dtype)
    return torch.allclose(rotation.mT @ rotation, eye, atol=1e-5) and float(torch.det(rotation)) > 0


def _plain(*tensors: Tensor) -> bool:
    """Whether numbers are on the CPU and nobody asks for their gradients."""
    if torch.compiler.is_compiling() or any(value.device.type != "cpu" for value in tensors):
        return False
    return not torch.is_grad_enabled() or not any(value.requires_grad for value in tensors)
