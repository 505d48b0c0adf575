"""Stiffness and motion learned together in a divergent force field (section 5.4, first experiment; Eq. 49-50)."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from tasks.force_fields.base import ARCH_SEARCH, ARCH_VIA_POINTS, RELEASED_ARCH_SEARCH, ArchTask, Setup, arch
from torchds import Rollout, costs
from torchds.plants import Force

GAIN = 10.0  # N/m
N_PATH = 400  # points of the nominal path

RELEASED_VIA_POINTS = ((-7.5, -1.0), (-5.0, 0.0), (-2.5, 1.0), (-2.5, 1.0), (-1.25, 0.5))


def radial_field(path: Tensor) -> Force:
    """10 N/m times the vector from the nearest point of `path` `(n, 2)` (Eq. 50, whose scalar gives no direction)."""

    def force(t: float, x: Tensor, v: Tensor) -> Tensor:
        return GAIN * (x - path[nearest(x, path)])

    return force


def normal_field(path: Tensor) -> Force:
    """The same size, but along the normal of the path's segment at the nearest point, pointing away (released)."""
    tangent = torch.cat([path.diff(dim=0), path[-1:] - path[-2:-1]])
    normal = torch.stack([-tangent[:, 1], tangent[:, 0]], -1)
    normal = normal / normal.norm(dim=-1, keepdim=True)

    def force(t: float, x: Tensor, v: Tensor) -> Tensor:
        index = nearest(x, path)
        offset, n = x - path[index], normal[index]
        return GAIN * offset.norm(dim=-1, keepdim=True) * torch.sign((n * offset).sum(-1, keepdim=True)) * n

    return force


def nearest(x: Tensor, path: Tensor) -> Tensor:
    """The index `(...)` of the point of `path` `(n, 2)` nearest to `x` `(..., 2)`."""
    return (path.square().sum(-1) - 2 * x.detach() @ path.mT).argmin(-1)


class DivergentField(ArchTask):
    """Off its nominal path the point mass is pushed away; the stiffness has to hold it, and should be low (Eq. 49).

    The cost is Σ_l min_j |x_l^via − x_j|² + |x^goal − x_T|² + 10⁻⁴ Σ_j |v_j − v_{j−1}| + 5·10⁻⁴ Σ_j |s_j| of the actual motion,
    and a control cost of r = 10⁻⁶. The motion starts a little off the nominal path.

    With convention="released", the problem is the one that the authors' program runs: a sine path of 100 points, the force
    along the local normal, one via-point counted twice, 10⁻⁴ |a_j|² for the acceleration, the sum of both axes' stiffness,
    the explicit controller, stiffness cut at zero. Give `demonstrations` or `mixture`.

    Args:
        initial_stiffness: s⁰ [N/m]; 20 if not given.
        stiffness_dim: 2 for a stiffness of each axis, 1 for the same on both.
        demonstrations: see `Task`.
        mixture: see `Task`; stiffness variables in it are replaced by s⁰.
        convention: see `Task`.
    """

    name = "divergent_field"
    bias = 0.3
    setups: ClassVar = {
        "paper": Setup((-11.7, -0.3), ARCH_VIA_POINTS, 15.0, 4, 20.0, 1e-4, 5e-4),
        "released": Setup((-10.0, 0.2), RELEASED_VIA_POINTS, 12.0, 3, 20.0, 1e-4, 5e-4),
    }
    searches: ClassVar = {"paper": ARCH_SEARCH, "released": RELEASED_ARCH_SEARCH}

    def nominal(self) -> Tensor:
        """The path without force `(n, 2)`."""
        if self.convention == "released":
            s = torch.arange(1, 101, dtype=torch.float64) / 100
            return torch.stack([-10 * (1 - s), torch.sin(2 * math.pi * (1 - s))], -1)
        return arch(torch.linspace(0, 1, N_PATH, dtype=torch.float64))

    def force(self) -> Force:
        """The divergent field."""
        return normal_field(self.nominal()) if self.convention == "released" else radial_field(self.nominal())

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal, acceleration and stiffness of Eq. 49."""
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        return {
            "via_points": costs.via_points(path.x, self.via_points),
            "goal": costs.goal(path.x, self.goal),
            **running,
        }

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """Acceleration and stiffness."""
        acceleration, stiffness = self.effort(path)
        return {
            "acceleration": self.setup.acceleration_weight * acceleration,
            "stiffness": self.setup.stiffness_weight * stiffness,
        }
