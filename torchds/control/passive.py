"""The passive velocity controller in the loop of a robot (Kronander and Billard 2016), with numpy alone.

Stability: stable.
"""

from __future__ import annotations

import math

import numpy as np

from torchds.control.tick import Tick
from torchds.errors import InvalidArgumentError


class PassiveLaw:
    r"""The force u = λ₁ f − D ẋ that a robot is driven with, f the velocity of a `Controller` with feedback.

    D has the eigenvalue λ₁ along f and λ₂ across it, see `torchds.passive`. With a tank, the field drives only while there
    is energy in it: what the damper takes fills it, what the drive spends empties it.

    Args:
        dt: time step of the loop [s].
        along: λ₁ [N s/m].
        across: λ₂ [N s/m]; `along` if None.
        tank: energy in the tank at the start [J]; None for no tank.
        capacity: largest energy in the tank [J].

    Attributes:
        tank: energy in the tank now [J].

    Raises:
        InvalidArgumentError: a damping below zero, or a tank that is negative or larger than its capacity.

    Example:
        >>> import torch, torchds
        >>> eye = torch.eye(2)[None]
        >>> policy = torchds.GMRPolicy(torch.ones(1), torch.zeros(1, 2), eye, -eye, torch.zeros(1, 2))
        >>> controller = torchds.Controller(policy, 0.001, feedback=True)
        >>> law = torchds.control.PassiveLaw(0.001, along=20.0, across=5.0)
        >>> controller.reset([1.0, 0.0])
        >>> law(controller.step([1.0, 0.0]), [0.0, 2.0])
        array([-20., -10.])
    """

    def __init__(
        self,
        dt: float,
        along: float,
        across: float | None = None,
        *,
        tank: float | None = None,
        capacity: float = math.inf,
    ) -> None:
        across = along if across is None else across
        for name, value in (("along", along), ("across", across)):
            if not 0 <= value < math.inf:
                raise InvalidArgumentError(f"{name} has to be finite and at least 0, got {value!r}")
        if tank is not None and not 0 <= tank <= capacity:
            raise InvalidArgumentError(f"tank has to be between 0 and capacity={capacity}, got {tank}")
        self.dt, self.along, self.across, self.capacity = dt, along, across, capacity
        self.tank = math.inf if tank is None else tank
        self._force = np.empty(0)

    def __call__(self, tick: Tick, v: np.ndarray) -> np.ndarray:
        """The force `(D,)` [N], in an array that the next call writes to again.

        Args:
            tick: of a controller with feedback, whose velocity is f at the measured position.
            v: `(D,)` the measured velocity.

        Raises:
            InvalidArgumentError: a measured velocity that is not D finite numbers.
        """
        field, now = tick._v.tolist()[: len(tick._x)], np.asarray(v, np.float64).tolist()
        if not isinstance(now, list) or len(now) != len(field) or not math.isfinite(sum(now)):
            raise InvalidArgumentError(f"v has to be the measured velocity of {len(field)} finite numbers, got {v!r}")
        if len(self._force) != len(field):
            self._force = np.empty(len(field))
        square = sum(f * f for f in field)
        dot = sum(f * u for f, u in zip(field, now, strict=True))  # f · ẋ
        turned = (self.along - self.across) * dot / square if square > 0 else 0.0
        drive = self.along
        if self.tank < math.inf:
            along = dot * dot / square if square > 0 else 0.0
            taken = self.across * (sum(u * u for u in now) - along) + self.along * along  # ẋᵀ D ẋ
            if self.tank + self.dt * (taken - drive * dot) < 0:
                drive = 0.0
            self.tank = min(self.tank + self.dt * (taken - drive * dot), self.capacity)
        self._force[:] = [(drive - turned) * f - self.across * u for f, u in zip(field, now, strict=True)]
        return self._force
