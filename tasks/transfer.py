"""Problems that nothing was tuned on: other letters at other scales, and a reach in space (docs/recommended.md)."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import torch
from torch import Tensor

from tasks.base import Task
from tasks.settings import Scene
from torchds import Demonstrations, Rollout, costs, load_lasa, rollout
from torchds.errors import InvalidArgumentError

UNITS = {"mm": 1.0, "m": 1e-3, "4 mm": 0.25}
"""LASA millimetres in each unit; the last one is that of `via_point`."""
PLACES = (0.2, 0.4, 0.6, 0.8)  # of the via-points, as shares of the length of the motion
ASIDE = 0.1  # by which they lie beside the motion, on alternating sides, in shares of its extent
ACCELERATION_WEIGHT = 1e-4  # where the extent of the motion is one


class Letter(Task):
    """Another letter, through via-points that a rule places beside the imitated motion.

    Four via-points lie at a fifth to four fifths of the length of the imitated motion, a tenth of its extent to its left and to
    its right in turn. With all lengths in units of the extent, the cost is Σ_l min_j |x_l^via − x_j|² + |x^goal − x_T|² +
    10⁻⁴ Σ_j |v_j − v_{j−1}|, without control cost, which would be of another size for each unit.

    Raises:
        InvalidArgumentError: an unknown letter or unit.
    """

    letters: ClassVar[dict[str, str]] = {"G": "GShape", "S": "Sshape", "W": "WShape"}

    letter: Literal["G", "S", "W"] = "G"
    """Which letter is drawn."""
    unit: Literal["mm", "m", "4 mm"] = "mm"
    """Unit of all lengths."""

    def __post_init__(self) -> None:
        if self.letter not in self.letters or self.unit not in UNITS:
            raise InvalidArgumentError(
                f"letter has to be {', '.join(self.letters)} and unit {', '.join(UNITS)}, got {self.letter!r} and {self.unit!r}"
            )
        self.goal = torch.zeros(2, dtype=torch.float64)
        with torch.no_grad():
            x = rollout(self.policy(), *self.motion()).x
        self.extent = float((x.amax(0) - x.amin(0)).norm())
        self.via_points = beside(x, ASIDE * self.extent)

    def default_demonstrations(self) -> Demonstrations:
        """The first three recordings of the letter."""
        return load_lasa(self.letters[self.letter], 3, scale=UNITS[self.unit]).every(5)

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Via-points, goal and acceleration."""
        return {
            "via_points": costs.via_points(path.x, self.via_points) / self.extent**2,
            "goal": costs.goal(path.x, self.goal) / self.extent**2,
            "acceleration": ACCELERATION_WEIGHT * costs.acceleration(path.v) / self.extent,
        }

    def scene(self) -> Scene:
        """Start, goal and via-points."""
        x0 = self.motion().x0
        return Scene(x0.reshape(-1, 2), self.goal, {"via-points": self.via_points}, unit=self.unit)


def beside(x: Tensor, distance: float) -> Tensor:
    """Points `(4, 2)` that far to the left and to the right, in turn, of a motion `(T+1, 2)`, at `PLACES`."""
    steps = x.diff(dim=0)
    length = torch.linalg.vector_norm(steps, dim=-1).cumsum(0)
    at = torch.searchsorted(length / length[-1], torch.tensor(PLACES, dtype=x.dtype))
    along = torch.nn.functional.normalize(steps[at], dim=-1)
    left = torch.stack([-along[:, 1], along[:, 0]], -1)
    sides = torch.tensor([1.0, -1.0, 1.0, -1.0], dtype=x.dtype).unsqueeze(-1)
    return x[at] + distance * sides * left


class Reach(Task):
    """Reach a goal in space past a ball that the demonstrated motions run through.

    The cost is |x^goal − x_T|² + Σ_j max(0, 1 − |x_j − c| / R) / 20 + 10⁻³ Σ_j |v_j − v_{j−1}|, of a motion of about one metre
    and a ball of radius R = 0.12 m about c.
    """

    duration: ClassVar[float] = 3.0
    center: ClassVar[tuple[float, float, float]] = (0.32, 0.2, 0.3)
    radius: ClassVar[float] = 0.12

    def default_demonstrations(self) -> Demonstrations:
        """Three bows from about (0.7, 0.4, 0.3) m to the origin, slowing down towards it."""
        s = (1 - torch.linspace(0, 1, 151, dtype=torch.float64)).pow(1.6).unsqueeze(-1)
        start = torch.tensor([0.7, 0.4, 0.3], dtype=torch.float64)
        bows = torch.tensor([[0.0, 0.0, 0.28], [0.03, -0.03, 0.32], [-0.03, 0.03, 0.24]], dtype=torch.float64)
        return Demonstrations(
            [s * start + torch.sin(math.pi * s) * bow for bow in bows], dt=self.duration / 150, units="m"
        )

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Goal, ball and acceleration."""
        away = torch.linalg.vector_norm(path.x[..., 1:, :] - path.x.new_tensor(self.center), dim=-1)
        return {
            "goal": costs.goal(path.x, path.x.new_zeros(3)),
            "ball": (1 - away / self.radius).clamp_min(0.0).sum(-1) / 20,
            "acceleration": 1e-3 * costs.acceleration(path.v),
        }


TRANSFER: dict[str, tuple[str, dict[str, str]]] = {
    **{
        f"letter-{letter}-{unit.replace(' ', '')}": (f"{__name__}:Letter", {"letter": letter, "unit": unit})
        for letter in Letter.letters
        for unit in UNITS
    },
    "reach": (f"{__name__}:Reach", {}),
}
"""These problems by name, as `tasks.PROBLEMS`."""
