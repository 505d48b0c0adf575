"""The torques of `torchds.cartesian` in compiled code, for arms of float64 on the CPU.

Stability: experimental.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torchds.arm_law import Gains, State
from torchds.errors import InvalidArgumentError
from torchds.kernels import arm
from torchds.kinematics import Screws
from torchds.targets import Plane, PlaneReference, Reference


class FusedArm:
    """The law with all that does not change from call to call.

    Args:
        screws: of the arm, with its tool.
        plane: of the task.
        gains: of the law.
        limit: `(J,)` of the torques, or None.
    """

    def __init__(self, screws: Screws, plane: Plane, gains: Gains, limit: Tensor | None) -> None:
        self.n_joints = len(gains.posture)
        self.plane = (plane.first, plane.second, plane.normal, plane.sign, float(plane.offset))
        none = np.full(self.n_joints, np.inf)
        self.constants = (
            _array(screws.axes),
            _array(screws.home),
            _array(gains.posture),
            np.array(gains[1:]),
            none if limit is None else _array(limit),
        )

    def __call__(
        self, state: State, reference: Reference, stiffness: Tensor, gains: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """What the fields of `CartesianControl` hold.

        Args:
            state: of the arms.
            reference: of the tool.
            stiffness: `(...)` s.
            gains: what stays of the stiffness `(6,)`, and what s is multiplied with.

        Raises:
            InvalidArgumentError: a reference that does not fit the arms, or a mass matrix that is none.
        """
        batch, J = state.q.shape[:-1], self.n_joints
        n = math.prod(batch)

        def flat(part: Tensor, *axes: int) -> np.ndarray:
            value = part.detach().numpy()
            if value.shape != (*batch, *axes) or value.dtype != np.float64:
                try:
                    value = np.array(np.broadcast_to(value, (*batch, *axes)), dtype=np.float64)
                except ValueError:
                    raise InvalidArgumentError(
                        f"a reference has to fit {tuple(batch)} arms, as {(*batch, *axes)}, got {value.shape}"
                    ) from None
            return np.ascontiguousarray(value).reshape(n, *axes)

        arms = [flat(part, *axes) for part, axes in zip(state, ((J,), (J,), (J, J), (J,)), strict=True)]
        if isinstance(reference, PlaneReference):
            wanted = [flat(part, *axes) for part, axes in zip(reference, ((2,), (), (2,), ()), strict=True)]
            target = [np.empty((n, *axes)) for axes in ((3,), (3, 3), (6,))]
            arm.in_space(n, *wanted, *self.plane, *target)
        else:
            x, rotation, v, rate = reference
            target = [flat(x, 3), flat(rotation, 3, 3), np.concatenate([flat(v, 3), flat(rate, 3)], 1)]
        made = [np.empty((n, *axes)) for axes in ((J,), (4, 4), (6,), (J,), (J,))]
        fine = np.empty(n, dtype=np.bool_)
        share = (_array(gains[1]), _array(gains[0]))
        arm.law(n, *arms, *target, flat(stiffness), *share, *self.constants, *made, fine)
        if not fine.all():
            raise InvalidArgumentError(
                "mass has to be symmetric and positive definite; is it the matrix of all joints?"
            )
        torque, pose, error, before, nullspace = (
            torch.from_numpy(part.reshape(*batch, *part.shape[1:])) for part in made
        )
        return torque, pose, error, torque != before, nullspace


def _array(value: Tensor) -> np.ndarray:
    return value.detach().contiguous().numpy()
