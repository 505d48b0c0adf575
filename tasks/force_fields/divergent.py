"""Stiffness and motion learned together in a divergent force field (section 5.4, first experiment; Eq. 49-50)."""

from __future__ import annotations

import torch
from torch import Tensor

from tasks.force_fields.base import ARCH_SEARCH, ARCH_VIA_POINTS, ArchTask, Setup, arch
from torchds import Rollout, costs
from torchds.forces import DivergentForce
from torchds.plants import Force

GAIN = 10.0  # N/m
N_PATH = 400  # points of the nominal path


class DivergentField(ArchTask):
    """Off its nominal path the point mass is pushed away; the stiffness has to hold it, and should be low (Eq. 49).

    The cost is Σ_l min_j |x_l^via − x_j|² + |x^goal − x_T|² + 10⁻⁴ Σ_j |v_j − v_{j−1}| + 5·10⁻⁴ Σ_j |s_j| of the actual motion,
    and a control cost of r = 10⁻⁶. The motion starts a little off the nominal path.
    """

    name = "divergent_field"
    bias = 0.3
    search = ARCH_SEARCH
    setup = Setup(
        start=(-11.7, -0.3),
        via_points=ARCH_VIA_POINTS,
        duration=15.0,
        acceleration_weight=1e-4,
        stiffness_weight=5e-4,
    )

    def nominal(self) -> Tensor:
        """The path without force `(n, 2)`."""
        return arch(torch.linspace(0, 1, N_PATH, dtype=torch.float64))

    def force(self) -> Force:
        """Away from the nearest point of the path (Eq. 50, whose scalar gives no direction)."""
        return DivergentForce(self.nominal(), GAIN)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal, acceleration and stiffness of Eq. 49."""
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {
            "via_points": costs.via_points(path.x, self.via_points),
            "goal": costs.goal(path.x, self.goal),
            **running,
        }

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The terms of acceleration and stiffness by steps."""
        acceleration, stiffness = self.effort(path)
        return {
            "acceleration": self.setup.acceleration_weight * acceleration,
            "stiffness": self.setup.stiffness_weight * stiffness,
        }
