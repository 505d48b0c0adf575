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
from torchds.targets import PoseReference


class FusedArm:
    """The law with all that does not change from call to call.

    Args:
        screws: of the arm, with its tool.
        gains: of the law.
        limit: `(J,)` of the torques, or None.
    """

    def __init__(self, screws: Screws, gains: Gains, limit: Tensor | None) -> None:
        self.n_joints = len(gains.posture)
        none = np.full(self.n_joints, np.inf)
        self.constants = (
            _array(screws.axes),
            _array(screws.home),
            _array(gains.posture),
            np.array(gains[1:]),
            none if limit is None else _array(limit),
        )

    def __call__(
        self, state: State, reference: PoseReference, stiffness: Tensor, gains: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """What the fields of `CartesianControl` hold.

        Args:
            state: of the arms.
            reference: of the tool.
            stiffness: `(...)` s.
            gains: what stays of the stiffness `(6,)`, and what s is multiplied with.
        """
        batch, J = state.q.shape[:-1], self.n_joints
        n = math.prod(batch)
        x, rotation, v, rate = reference
        twist = torch.cat([v.expand(*batch, 3), rate.expand(*batch, 3)], -1)
        given = (*state, x.expand(*batch, 3), rotation.expand(*batch, 3, 3), twist, stiffness.expand(batch))
        sizes = ((J,), (J,), (J, J), (J,), (3,), (3, 3), (6,), ())
        parts = [_array(part).reshape(n, *size) for part, size in zip(given, sizes, strict=True)]
        made = [np.empty((n, *size)) for size in ((J,), (4, 4), (6,), (J,), (J,))]
        fine = np.empty(n, dtype=np.bool_)
        arm.law(n, *parts, *(_array(part) for part in (gains[1], gains[0])), *self.constants, *made, fine)
        if not fine.all():
            raise InvalidArgumentError(
                "mass has to be symmetric and positive definite; is it the matrix of all joints?"
            )
        torque, pose, error, wanted, nullspace = (
            torch.from_numpy(part.reshape(*batch, *part.shape[1:])) for part in made
        )
        return torque, pose, error, torque != wanted, nullspace


def _array(value: Tensor) -> np.ndarray:
    return value.detach().contiguous().numpy()
