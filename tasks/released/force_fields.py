"""The force fields as the authors' program runs them."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from tasks.force_fields.base import ArchTask, Setup
from tasks.force_fields.divergent import GAIN, DivergentField
from tasks.force_fields.half_plane import HalfPlaneForce
from tasks.imitation import say_left_out, with_stiffness
from tasks.released.base import RELEASED_SEARCH, Released
from torchds import GMRPolicy, Rollout
from torchds.forces import DivergentForce
from torchds.plants import Force

VIA_POINTS = ((-7.5, -1.0), (-5.0, 0.0), (-2.5, 1.0), (-1.25, 0.5))
SEARCH = replace(RELEASED_SEARCH, n_updates=100, control_weight=1e-6, mean_stiffness=10.0)


class ReleasedArch(Released, ArchTask):
    """What both have in common: the explicit controller, stiffness cut at zero, and other measures of effort."""

    n_components = 3
    search = SEARCH
    form = "explicit"
    low, high = 0.0, math.inf

    def policy(self) -> GMRPolicy:
        """The imitated motion with the constant stiffness s⁰, as the program begins whatever its mixture carries."""
        say_left_out(self.mixture, 4, "the released program begins with the constant initial_stiffness")
        return with_stiffness(self.mixture.marginal(0, 4), 2, 2, self.stiffness_dim, self.initial_stiffness)

    def effort(self, path: Rollout) -> tuple[Tensor, Tensor]:
        """|a_j|², and the sum of both axes' stiffness, `(*batch, *points, T)`."""
        stiffness = path.plant.stiffness[..., 1:, :].sum(-1)
        return path.plant.acceleration[..., 1:, :].square().sum(-1), stiffness


class ReleasedDivergentField(ReleasedArch, DivergentField):
    """`DivergentField` along a sine path of 100 points, the force along the local normal, one via-point counted twice."""

    name = "divergent_field"
    setup = Setup(
        start=(-10.0, 0.2),
        via_points=(*VIA_POINTS[:3], *VIA_POINTS[2:]),
        duration=12.0,
        acceleration_weight=1e-4,
        stiffness_weight=5e-4,
        unit="",
    )

    def nominal(self) -> Tensor:
        """The sine path `(100, 2)`."""
        s = torch.arange(1, 101, dtype=torch.float64) / 100
        return torch.stack([-10 * (1 - s), torch.sin(2 * math.pi * (1 - s))], -1)

    def force(self) -> Force:
        """The force along the normal of the sine path."""
        return DivergentForce(self.nominal(), GAIN, along_normal=True)


class ReleasedHalfPlaneForce(ReleasedArch, HalfPlaneForce):
    """`HalfPlaneForce` with efforts of the disturbed execution alone, halved; r = 10⁻⁷.

    Via-points and goal are averaged over both executions.
    """

    name = "half_plane_force"
    search = replace(SEARCH, control_weight=0.5e-7)  # half, as in `HalfPlaneForce`
    setup = Setup(
        start=(-10.0, 0.0),
        via_points=VIA_POINTS,
        duration=12.0,
        acceleration_weight=1e-3,
        stiffness_weight=2e-4,
        unit="",
    )

    def over_executions(self, value: Tensor) -> Tensor:
        """Half of what the disturbed execution costs."""
        return 0.5 * value[..., 1, :]
