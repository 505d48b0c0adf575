"""What the problems of the authors' released program have in common (`convention="released"`)."""

from __future__ import annotations

from dataclasses import replace

import torch

from tasks.base import Task
from tasks.released.exploration import ReleasedHomogeneous
from tasks.settings import PAPER_SEARCH
from torchds import Demonstrations, GaussianMixture
from torchds.errors import InvalidArgumentError
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

STIFFNESS = 10.0  # N/m, constant where the policy has no stiffness of its own
FLOOR = 1e-5  # added to the covariances in every M-step, and once more at the end

RELEASED_SEARCH = replace(PAPER_SEARCH, homogeneous=ReleasedHomogeneous, temperature="median", decay="linear")


def released_plant() -> ImpedanceControlled:
    """A unit point mass with unit damping that tracks its reference."""
    return ImpedanceControlled(PointMass(mass=1.0, damping=1.0), STIFFNESS, form="explicit")


class Released(Task):
    """A problem as the program runs it; its demonstrations are not part of this project, so that the user brings them."""

    convention = "released"

    def default_demonstrations(self) -> Demonstrations:
        """There are none to give.

        Raises:
            InvalidArgumentError: always.
        """
        raise InvalidArgumentError(
            f"{self.name} with convention={self.convention!r} has no demonstrations of its own, since those of the authors "
            "come without a licence to pass them on; give demonstrations=PATH or mixture=PATH"
        )

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """EM as the program does it: from k-means, to a relative change of 1e-10, with a floor that is added twice.

        The program pairs positions with forward differences, and so does this where positions alone were recorded; recordings
        with their own velocities keep these.
        """
        if demonstrations.differentiated:
            demonstrations = demonstrations.forward_differences()
        fitted = GaussianMixture.fit(demonstrations, self.n_components, covariance_floor=FLOOR, tol=1e-10)
        identity = torch.eye(fitted.means.shape[-1], dtype=fitted.means.dtype)
        return GaussianMixture(fitted.priors, fitted.means, fitted.covariances + FLOOR * identity)
