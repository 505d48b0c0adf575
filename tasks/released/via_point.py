"""The via-point letters as the authors' program runs them."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from tasks.released.base import RELEASED_SEARCH, Released, released_plant
from tasks.via_point import ACCELERATION_WEIGHT, Setup, ViaPoint
from torchds import Rollout

N = Setup(
    start=(-130.0, -100.0),
    via_points=((-120.0, -10.0), (-60.0, -40.0), (-30.0, -110.0)),
    duration=12.0,
    dt=0.1,
    unit="mm",
)
P = Setup(
    start=(-40.0, -20.0),
    via_points=((-45.0, 20.0), (-10.0, 30.0), (10.0, 15.0)),
    duration=15.0,
    dt=0.1,
    unit="mm",
)


class ReleasedViaPoint(Released, ViaPoint):
    """`ViaPoint` with a plant, quirks included.

    A unit point mass with unit damping tracks the reference with the constant stiffness 10 (explicit controller); the N is
    costed at the plant's positions, the P at the reference's; the acceleration term is 10⁻⁴ Σ_j |a_j|² of the plant in both;
    the exploration is a tenth of the local speed, its standard deviation falls linearly, and the temperature uses the median.
    """

    name = "via_point"
    search = RELEASED_SEARCH
    plant = released_plant()
    setups: ClassVar = {"N": N, "P": P}

    def judged(self, path: Rollout) -> Tensor:
        """Where the plant is for the N, the reference for the P."""
        return path.x if self.shape == "N" else path.reference

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration term, that of the plant, by steps."""
        return {"acceleration": ACCELERATION_WEIGHT * path.plant.acceleration[..., 1:, :].square().sum(-1)}
