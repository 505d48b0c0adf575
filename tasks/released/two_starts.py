"""The two starts as the authors' program runs them."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from tasks.released.base import RELEASED_SEARCH, Released, released_plant
from tasks.two_starts import ACCELERATION_WEIGHT, Setup, TwoStarts
from torchds import Rollout


class ReleasedTwoStarts(Released, TwoStarts):
    """`TwoStarts` with a plant, quirks included.

    A unit point mass tracks the reference as in `ReleasedViaPoint`; costs are averaged over the starts, not added; by a slip
    of an index the acceleration term is that of the right start alone, and the average halves it.
    """

    name = "two_starts"
    n_components = 7
    # The optimizer adds the control cost of both starts; half the weight makes it their mean.
    search = replace(RELEASED_SEARCH, n_updates=200, n_rollouts=20, control_weight=2.5e-4, elite="best")
    plant = released_plant()
    setup = Setup(
        starts=((-8.0, 0.0), (8.0, 0.0)),
        via_points={
            "left": ((-6.0, -3.0), (-4.0, 0.0), (-2.0, 3.0)),
            "right": ((6.0, 0.0), (5.0, -4.0), (3.0, -4.0), (2.0, 0.0)),
        },
        duration=11.0,
        dt=0.1,
        unit="",
    )

    def over_starts(self, value: Tensor) -> Tensor:
        """The mean of a term over both starts."""
        return value.mean(-1)

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The acceleration term by steps: half that of the plant from the right start."""
        squared = path.plant.acceleration[..., 1, 1:, :].square().sum(-1)
        return {"acceleration": 0.5 * ACCELERATION_WEIGHT * squared}
