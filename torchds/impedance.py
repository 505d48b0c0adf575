"""Impedance control: a plant pulled along its reference by a spring and a damper (section 5).

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from torchds.arms import Arm as Arm
from torchds.arms import arm as arm
from torchds.arrays import Array, beside, broadcast_shape, number, over, real
from torchds.cartesian import CartesianImpedance as CartesianImpedance
from torchds.devices import Movable
from torchds.disturbances import Disturbance
from torchds.errors import InvalidArgumentError
from torchds.kernels.steps import IMPEDANCE, ScalarStep, own
from torchds.passive import PassiveControlled
from torchds.plants import Command, PointMass, PointMassState
from torchds.rollouts import Rollout
from torchds.targets import PlaneReference as PlaneReference
from torchds.targets import PoseReference as PoseReference


class ImpedanceControlled(Movable):
    r"""A point mass under the impedance controller of Eq. 33, u = S (x^ref − x) + D (v^ref − v), itself a plant.

    S = diag(s) and D = diag(2 \sqrt{s m}): critically damped. The stiffness comes from the policy, or is constant.

    Args:
        plant: the point mass.
        stiffness: a constant [N/m], number or `(D,)`, in place of the policy's; None to take the policy's.
        form: where in time the controller looks.

            * "implicit": Eq. 33 as printed, u_t = S (x^ref_{t−1} − x_t) + D (v^ref_{t−1} − v_t) with x_t, v_t the state
              that u_t leads to, solved exactly (S and D are diagonal).
            * "explicit": as the authors' program has it, with the new reference and the state before the step.
        low: smallest stiffness of the policy's that is applied [N/m].
        high: largest stiffness of the policy's that is applied [N/m].
        max_rate: largest change of the applied stiffness [N/m/s], a limit on the energy that changes can inject; None
            for none.
        rows: for each of the D axes, which of the policy's stiffness rows it follows, e.g. (0, 0) for an isotropic
            stiffness in two dimensions; None for one to one, or the only row for all axes.
        disturbance: what the controller measures wrongly, and how the point mass is pushed; None for a plant without noise.

    Raises:
        InvalidArgumentError: an unknown form, bounds that are no interval of numbers ≥ 0, a negative constant, a rate
            that is not positive; from a roll-out, a policy without stiffness where none is given here, or without the
            rows that it needs.
    """

    def __init__(
        self,
        plant: PointMass,
        stiffness: float | Array | None = None,
        *,
        form: Literal["implicit", "explicit"] = "implicit",
        low: float = 0.0,
        high: float = float("inf"),
        max_rate: float | None = None,
        rows: Sequence[int] | None = None,
        disturbance: Disturbance | None = None,
    ) -> None:
        if form not in ("implicit", "explicit"):
            raise InvalidArgumentError(f"form has to be 'implicit' or 'explicit', got {form!r}")
        low, high = (number(name, n, "a number", lambda _: True) for name, n in (("low", low), ("high", high)))
        if not 0 <= low <= high:
            raise InvalidArgumentError(f"low and high have to be 0 ≤ low ≤ high, got low={low} and high={high}")
        constant = None if stiffness is None else real("stiffness", stiffness)
        if constant is not None and not (constant >= 0).all():
            raise InvalidArgumentError(f"a constant stiffness has to be ≥ 0, got {stiffness}")
        if max_rate is not None:
            max_rate = number("max_rate", max_rate, "positive", lambda n: n > 0)
        self.plant = plant
        self.stiffness = float(constant) if constant is not None and constant.ndim == 0 else constant
        self.form = form
        self.low, self.high = low, high
        self.max_rate = max_rate
        self.rows = rows
        self.disturbance = disturbance

    def reset(self, x0: Tensor) -> PointMassState:
        """At rest at `x0`."""
        return self.plant.reset(x0)

    def step(self, state: PointMassState, command: Command) -> PointMassState:
        """One step of Eq. 29-33; the external force is taken at the state before it."""
        m, d, dt, n_axes = self.plant.mass, self.plant.damping, command.dt, state.x.shape[-1]
        wanted = (command.v if self.form == "explicit" else command.v_before)[..., :n_axes]  # more outputs move no axis
        s = self._stiffness(state.x, command.stiffness)
        if self.max_rate is not None and command.t > 0:
            step = self.max_rate * dt
            s = state.stiffness + (s - state.stiffness).clamp(-step, step)
        D = 2 * (s * m).sqrt()
        measured, speed, force = state.x, state.v, self.plant.external(command.t, state)
        if self.disturbance is not None:
            chance = self.disturbance.at(command.t, dt, measured)
            measured, speed, force = measured + chance.position, speed + chance.velocity, force + chance.force
        if self.form == "explicit":
            u = s * (command.x - measured) + D * (wanted - speed)
            a = (u + force - d * state.v) / m
        else:
            # x_t = x + v_t dt and v_t = v + a dt in Eq. 33, solved for a.
            u = s * (command.x_before - measured - dt * state.v) + D * (wanted - speed)
            a = (u + force - d * state.v) / (m + s * dt * dt + D * dt)
        x, v = self.plant.advance(state, a, dt)
        return PointMassState(x, v, a, s, force)

    def measured(self, state: PointMassState, t: float, dt: float) -> Tensor:
        """Where the point mass seems to be `(*batch, *points, D)`, which is what a policy with feedback sees."""
        return state.x if self.disturbance is None else state.x + self.disturbance.at(t, dt, state.x).position

    def scalar_step(self, n_axes: int, n_rows: int) -> ScalarStep | None:
        """The same for compiled code; None with a force that has no scalar step."""
        if type(self) is not ImpedanceControlled or type(self.plant) is not PointMass:
            return None
        force, push = None, self.plant.force
        if push is not None:
            make = own(push, "scalar_step")
            if make is None or (force := make(n_axes, n_rows)) is None:
                return None
        max_rate = math.inf if self.max_rate is None else self.max_rate
        limits = (self.low, self.high, max_rate)
        numbers = (self.plant.mass, self.plant.damping, self.form == "explicit", *limits, self.stiffness is not None)
        followed = self._followed(n_axes, n_rows) if self.stiffness is None else self.stiffness
        axes = torch.empty(n_axes, dtype=torch.float64)
        each = beside("stiffness", followed, axes, "a number or (D,)", last=0)
        each = each.expand(*each.shape[:-1], n_axes)  # the constant of each axis, or the row that it follows
        common = each.new_tensor([float(number) for number in numbers]).expand(*each.shape[:-1], len(numbers))
        parts = [common, each, *(() if self.disturbance is None else (self.disturbance.flat.to(each),))]
        lead = broadcast_shape(*(part.shape[:-1] for part in parts))
        return ScalarStep(IMPEDANCE, torch.cat([part.expand(*lead, part.shape[-1]) for part in parts], -1), force)

    def _stiffness(self, x: Tensor, asked: Tensor | None) -> Tensor:
        if isinstance(self.stiffness, float):
            return torch.full_like(x, self.stiffness)
        if self.stiffness is not None:
            return over("stiffness", self.stiffness, x, "a number or (D,)", last=0)
        if asked is None:
            asked = x[..., :0]
        return asked.clamp(self.low, self.high)[..., self._followed(x.shape[-1], asked.shape[-1])]

    def _followed(self, n_axes: int, n_rows: int) -> list[int]:
        """For each axis the policy's stiffness row that it follows."""
        index = list(self.rows) if self.rows is not None else [0] * n_axes if n_rows == 1 else list(range(n_rows))
        if not n_rows or len(index) != n_axes or not all(0 <= i < n_rows for i in index):
            received = f"{n_rows} stiffness rows" if n_rows else "a policy without stiffness"
            raise InvalidArgumentError(
                f"{received} cannot control {n_axes} axes by rows={tuple(index)}: make the policy with stiffness_dim=1 (the "
                f"same for all axes) or {n_axes}, or give ImpedanceControlled a constant stiffness"
            )
        return index


def injected_energy(path: Rollout) -> Tensor:
    """Energy that changes of the stiffness put into the spring, Σ_t max(0, ½ Σ_d (s_t − s_{t−1}) e_{t−1}²) `(...)` [J].

    With constant stiffness the spring and the damper are passive; raising the stiffness while the spring is stretched by e
    is what can inject energy.

    Args:
        path: a roll-out under `ImpedanceControlled`.
    """
    s: Tensor = path.plant.stiffness[..., 1:, :]
    stretch: Tensor = (path.reference - path.plant.x)[..., 1:-1, :]
    return (0.5 * s.diff(dim=-2) * stretch.square()).sum(-1).clamp_min(0.0).sum(-1)


def clamped_share(path: Rollout, controlled: ImpedanceControlled | PassiveControlled) -> Tensor:
    """Share of steps and stiffness rows of the policy that were outside the bounds `(...)`, between 0 and 1.

    Args:
        path: a roll-out of a policy with stiffness.
        controlled: its plant, for the bounds.

    Raises:
        InvalidArgumentError: the policy has no stiffness.
    """
    if path.stiffness is None:
        raise InvalidArgumentError("this roll-out is of a policy without stiffness; nothing was clamped")
    outside = (path.stiffness < controlled.low) | (path.stiffness > controlled.high)
    return outside.to(path.x.dtype).mean((-2, -1))
