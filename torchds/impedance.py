"""Impedance control: a plant pulled along its reference by a spring and a damper (section 5)."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from torchds.errors import InvalidArgumentError
from torchds.plants import Command, Motion, PointMass


class ImpedanceControlled:
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

    The policy's Q stiffness rows go to the D axes one to one, or one row to all axes.

    Raises:
        InvalidArgumentError: an unknown form, bounds that are no interval of numbers ≥ 0, a negative constant; from a
            roll-out, a policy without stiffness where none is given here, or with a number of rows neither 1 nor D.
    """

    def __init__(
        self,
        plant: PointMass,
        stiffness: float | Tensor | None = None,
        *,
        form: Literal["implicit", "explicit"] = "implicit",
        low: float = 0.0,
        high: float = float("inf"),
    ) -> None:
        if form not in ("implicit", "explicit"):
            raise InvalidArgumentError(f"form has to be 'implicit' or 'explicit', got {form!r}")
        if not 0 <= low <= high:
            raise InvalidArgumentError(f"0 ≤ low ≤ high is needed, got low={low} and high={high}")
        if stiffness is not None and not (torch.as_tensor(stiffness) >= 0).all():
            raise InvalidArgumentError(f"a constant stiffness has to be ≥ 0, got {stiffness}")
        self.plant = plant
        self.stiffness = stiffness
        self.form = form
        self.low, self.high = low, high

    def reset(self, x0: Tensor) -> Motion:
        """At rest at `x0`."""
        return self.plant.reset(x0)

    def step(self, state: Motion, command: Command) -> Motion:
        """One step of Eq. 29-33; the external force is taken at the state before it."""
        m, d, dt = self.plant.mass, self.plant.damping, command.dt
        s = self._stiffness(state.x, command.stiffness)
        D = 2 * (s * m).sqrt()
        force = self.plant.external(command.t, state)
        if self.form == "explicit":
            u = s * (command.x - state.x) + D * (command.v - state.v)
            a = (u + force - d * state.v) / m
        else:
            # x_t = x + v_t dt and v_t = v + a dt in Eq. 33, solved for a.
            u = s * (command.x_before - state.x - dt * state.v) + D * (command.v_before - state.v)
            a = (u + force - d * state.v) / (m + s * dt * dt + D * dt)
        x, v = self.plant.advance(state, a, dt)
        return Motion(x, v, a, s, force)

    def _stiffness(self, x: Tensor, rows: Tensor | None) -> Tensor:
        if self.stiffness is not None:
            return torch.as_tensor(self.stiffness, dtype=x.dtype, device=x.device).expand_as(x)
        if rows is None or rows.shape[-1] not in (1, x.shape[-1]):
            received = "a policy without stiffness" if rows is None else f"{rows.shape[-1]} stiffness rows"
            raise InvalidArgumentError(
                f"{received} cannot control {x.shape[-1]} axes: make the policy with stiffness_dim=1 (the same for all "
                f"axes) or {x.shape[-1]}, or give ImpedanceControlled a constant stiffness"
            )
        return rows.clamp(self.low, self.high).expand_as(x)
