"""What the problems of the authors' released program have in common (`convention="released"`)."""

from __future__ import annotations

import torch

from tasks.base import SearchSettings
from tasks.released.exploration import ReleasedHomogeneous
from torchds import Demonstrations, GaussianMixture
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

STIFFNESS = 10.0  # N/m, constant where the policy has no stiffness of its own
FLOOR = 1e-5  # added to the covariances in every M-step, and once more at the end

RELEASED_SEARCH = SearchSettings(homogeneous=ReleasedHomogeneous, temperature="median", decay="linear")


def released_plant() -> ImpedanceControlled:
    """A unit point mass with unit damping that tracks its reference."""
    return ImpedanceControlled(PointMass(mass=1.0, damping=1.0), STIFFNESS, form="explicit")


def released_fit(demonstrations: Demonstrations, n_components: int) -> GaussianMixture:
    """EM as the program does it: from k-means, to a relative change of 1e-10, with a floor that is added twice.

    The program pairs positions with forward differences; recordings with their own velocities keep these.
    """
    fitted = GaussianMixture.fit(demonstrations, n_components, covariance_floor=FLOOR, tol=1e-10)
    identity = torch.eye(fitted.means.shape[-1], dtype=fitted.means.dtype)
    return GaussianMixture(fitted.priors, fitted.means, fitted.covariances + FLOOR * identity)
