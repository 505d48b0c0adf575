"""Exploration: objects that shape unit normals into parameter noise (section 4).

Stability: stable.
"""

from torchds.exploration.base import Exploration as Exploration
from torchds.exploration.gaussian import Gaussian as Gaussian
from torchds.exploration.homogeneous import Homogeneous as Homogeneous
from torchds.exploration.stable import Stable as Stable
from torchds.exploration.trajectory import Coordinates as Coordinates
from torchds.exploration.trajectory import TrajectorySpace as TrajectorySpace

__all__ = ["Coordinates", "Exploration", "Gaussian", "Homogeneous", "Stable", "TrajectorySpace"]
