"""A force that is there in half of the executions, and only in half of the plane (section 5.4, second experiment)."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from tasks.force_fields.base import ARCH_SEARCH, ARCH_VIA_POINTS, ArchTask, Setup
from tasks.settings import Motion
from torchds import Rollout, costs
from torchds.forces import ConstantForce
from torchds.plants import Force

BORDER, FORCE = -5.0, 10.0  # N upwards where x1 > BORDER


class HalfPlaneForce(ArchTask):
    """[0, 10] N for x₁ > −5 in half of the executions: the stiffness has to rise where the force may be (Eq. 51).

    Every policy is tried without and with the force, and costs the mean of the two: Σ_l min_j |x_l^via − x_j|² +
    |x^goal − x_T|² + 10⁻³ Σ_j |v_j − v_{j−1}| + 2·10⁻⁴ Σ_j |s_j|, and a control cost of r = 10⁻⁶. The position that
    decides is the actual one.
    """

    name = "half_plane_force"
    bias = 0.1
    # The optimizer adds the control cost of both executions; half the weight is their mean.
    search = replace(ARCH_SEARCH, mean_speed=0.05, control_weight=0.5e-6)
    setup = Setup(
        start=(-12.0, 0.0),
        via_points=ARCH_VIA_POINTS,
        duration=15.0,
        acceleration_weight=1e-3,
        stiffness_weight=2e-4,
    )

    initial_stiffness: float = 10.0
    """Constant stiffness before learning, s⁰ [N/m]."""

    def force(self) -> Force:
        """No force in the first execution of a policy; in the second one, the force of the half-plane."""
        return ConstantForce(torch.tensor([[0.0, 0.0], [0.0, FORCE]], dtype=torch.float64), border=BORDER)

    def motion(self) -> Motion:
        """Both executions begin at the same start."""
        motion = super().motion()
        return motion._replace(x0=motion.x0.expand(2, 2))

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal, acceleration and stiffness of Eq. 51, mean over the executions."""
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {
            "via_points": costs.via_points(path.x, self.via_points).mean(-1),
            "goal": costs.goal(path.x, self.goal).mean(-1),
            **running,
        }

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The terms of acceleration and stiffness by steps, means over the executions."""
        acceleration, stiffness = (self.over_executions(value) for value in self.effort(path))
        return {
            "acceleration": self.setup.acceleration_weight * acceleration,
            "stiffness": self.setup.stiffness_weight * stiffness,
        }

    def over_executions(self, value: Tensor) -> Tensor:
        """What an effort `(*batch, 2, T)` costs over both executions `(*batch, T)`."""
        return value.mean(-2)
