"""A force that is there in half of the executions, and only in half of the plane (section 5.4, second experiment)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import torch
from torch import Tensor

from tasks.base import Convention, Motion
from tasks.force_fields.base import ARCH_SEARCH, ARCH_VIA_POINTS, RELEASED_ARCH_SEARCH, ArchTask, Setup
from torchds import Demonstrations, GaussianMixture, Rollout, costs
from torchds.errors import InvalidArgumentError
from torchds.plants import Force

BORDER, FORCE = -5.0, 10.0  # N upwards where x1 > BORDER

RELEASED_VIA_POINTS = ((-7.5, -1.0), (-5.0, 0.0), (-2.5, 1.0), (-1.25, 0.5))


class HalfPlaneForce(ArchTask):
    """[0, 10] N for x₁ > −5 in half of the executions: the stiffness has to rise where the force may be (Eq. 51).

    Every policy is tried without and with the force, and costs the mean of the two: Σ_l min_j |x_l^via − x_j|² +
    |x^goal − x_T|² + 10⁻³ Σ_j |v_j − v_{j−1}| + 2·10⁻⁴ Σ_j |s_j|, and a control cost of r = 10⁻⁶. The position that
    decides is the actual one.

    With convention="released", the problem is the one that the authors' program runs: via-points and goal are averaged over
    both executions, but the acceleration term is that of the disturbed one, halved, and so is the stiffness term; r = 10⁻⁷;
    otherwise as `DivergentField`.

    Args:
        stiffness: "diagonal" for a stiffness of each axis, "isotropic" for the same on both.
        initial_stiffness: s⁰ [N/m]; 10 if not given.
        demonstrations: see `Task`.
        mixture: see `Task`; stiffness variables in it are replaced by s⁰.
        convention: see `Task`.

    Raises:
        InvalidArgumentError: an unknown kind of stiffness or convention, or the released one without data.
    """

    name = "half_plane_force"
    bias = 0.1
    setups: ClassVar = {
        "paper": Setup((-12.0, 0.0), ARCH_VIA_POINTS, 15.0, 4, 10.0, 1e-3, 2e-4),
        "released": Setup((-10.0, 0.0), RELEASED_VIA_POINTS, 12.0, 3, 10.0, 1e-3, 2e-4),
    }
    # The optimizer adds the control cost of both executions; half the weight is their mean.
    searches: ClassVar = {
        "paper": replace(ARCH_SEARCH, mean_speed=0.05, control_weight=0.5e-6),
        "released": replace(RELEASED_ARCH_SEARCH, control_weight=0.5e-7),
    }

    def __init__(
        self,
        stiffness: Literal["diagonal", "isotropic"] = "diagonal",
        *,
        initial_stiffness: float | None = None,
        demonstrations: Demonstrations | str | Path | None = None,
        mixture: GaussianMixture | str | Path | None = None,
        convention: Convention = "paper",
    ) -> None:
        if stiffness not in ("diagonal", "isotropic"):
            raise InvalidArgumentError(f"stiffness has to be 'diagonal' or 'isotropic', got {stiffness!r}")
        super().__init__(
            initial_stiffness=initial_stiffness,
            stiffness_dim=2 if stiffness == "diagonal" else 1,
            demonstrations=demonstrations,
            mixture=mixture,
            convention=convention,
        )

    def force(self) -> Force:
        """None in the first execution, the half-plane's in the second."""
        present = torch.tensor([[0.0, 0.0], [0.0, FORCE]], dtype=torch.float64)  # (executions, D)

        def force(t: float, x: Tensor, v: Tensor) -> Tensor:
            return torch.where(x[..., :1] > BORDER, present.to(x), 0.0)

        return force

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
        """Acceleration and stiffness, mean over the executions."""
        acceleration, stiffness = self.effort(path)  # (*batch, 2, T)
        if self.convention == "released":
            acceleration, stiffness = 0.5 * acceleration[..., 1, :], 0.5 * stiffness[..., 1, :]
        else:
            acceleration, stiffness = acceleration.mean(-2), stiffness.mean(-2)
        return {
            "acceleration": self.setup.acceleration_weight * acceleration,
            "stiffness": self.setup.stiffness_weight * stiffness,
        }
