"""What the two force-field tasks share: an arch through four via-points, a compliant point mass, learned stiffness."""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import torch
from torch import Tensor

from tasks.base import Task
from tasks.imitation import with_stiffness
from tasks.settings import PAPER_FLOOR, PAPER_SEARCH, Motion, Scene
from torchds import Demonstrations, GMRPolicy, Rollout, costs, disturbances
from torchds.arrays import number
from torchds.devices import moved
from torchds.errors import InvalidArgumentError
from torchds.impedance import ImpedanceControlled, clamped_share, injected_energy
from torchds.passive import PassiveControlled
from torchds.plants import Force, Plant, PointMass

LOW, HIGH = 0.1, 1000.0  # N/m, bounds of the applied stiffness


@dataclass(frozen=True, kw_only=True)
class Setup:
    """The constants of one task.

    Attributes:
        start: of motion and plant [m].
        via_points: [m]; one that stands twice counts twice.
        duration: T dt [s].
        acceleration_weight: of |v_j − v_{j−1}| (paper) or |a_j|² (released).
        stiffness_weight: of |s_j| (paper) or the sum of the axes' stiffness (released).
        unit: of positions.
    """

    start: tuple[float, float]
    via_points: tuple[tuple[float, float], ...]
    duration: float
    acceleration_weight: float
    stiffness_weight: float
    unit: str = "m"


# The paper names no via-points; these lie on the arch, but for the bend after the top.
ARCH_VIA_POINTS = ((-9.0, 4.3), (-6.0, 4.0), (-3.6, 1.8), (-1.4, 0.4))
DT = 0.1  # s


# 100 updates of 10 roll-outs, with noise of 2 N/m in the stiffness beside that of the motion.
ARCH_SEARCH = replace(PAPER_SEARCH, n_updates=100, control_weight=1e-6, mean_stiffness=2.0)


def arch(s: Tensor) -> Tensor:
    """The nominal path (−12 (1−s), 4 sin πs + 1.5 sin 2πs) [m] at progress `s` in [0, 1]."""
    return torch.stack([-12 * (1 - s), 4 * torch.sin(math.pi * s) + 1.5 * torch.sin(2 * math.pi * s)], -1)


def arch_demonstrations(bias: float) -> Demonstrations:
    """Three imperfect motions along the arch, 14 s each, slowing down towards the goal.

    Args:
        bias: by how much all of them pass beside the arch [m], to the same side, half-way.
    """
    tau = torch.linspace(0, 1, 141, dtype=torch.float64)
    s = 1 - (1 - tau) ** 1.5
    x = arch(s)
    (tangent,) = torch.gradient(x, dim=0)
    normal = torch.stack([-tangent[:, 1], tangent[:, 0]], -1)
    normal = normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    bump, wave = torch.sin(math.pi * s)[:, None], torch.sin(2 * math.pi * s)[:, None]
    fade = (1 - s)[:, None]
    starts = torch.tensor([[0.0, -0.3], [0.2, 0.0], [-0.2, 0.3]], dtype=torch.float64)
    motions = [x + (bias * bump + 0.3 * (i - 1) * wave) * normal + fade * start for i, start in enumerate(starts)]
    return Demonstrations(motions, dt=14.0 / 140, units="m")


class ArchTask(Task):
    """Pass through via-points with a compliant point mass in a force field, at a low stiffness (Eq. 49, 51).

    A unit point mass with unit damping tracks the reference under the implicit impedance controller of Eq. 33. The policy
    gives velocity and stiffness; the task's own demonstrations say nothing about the stiffness, so it begins as the constant
    s⁰; that of given ones, or of a given mixture, is taken. The cost is that of the actual motion and of the stiffness as
    applied, between 0.1 and 1000 N/m. In closed loop the policy is a feedback law; the passive controller has no spring, and
    the stiffness says how much it damps (`torchds.passive`).

    Raises:
        InvalidArgumentError: an unknown kind of stiffness or of execution.
    """

    setup: ClassVar[Setup]
    bias: ClassVar[float]
    covariance_floor = PAPER_FLOOR
    form: ClassVar[Literal["implicit", "explicit"]] = "implicit"
    low: ClassVar[float] = LOW
    high: ClassVar[float] = HIGH

    initial_stiffness: float = 20.0
    """Constant stiffness before learning, s⁰ [N/m], where none was demonstrated."""
    stiffness: Literal["diagonal", "isotropic"] = "diagonal"
    """A stiffness for each axis, or one for both."""
    execution: Literal["open", "closed", "passive"] = "open"
    """The policy sees its own reference, the point mass under impedance control, or that under the passive controller."""
    sensor_noise: float = 0.0
    """Standard deviation of the measured position of the point mass in the trials that are learned from [m]."""
    pushes: float = 0.0
    """Standard deviation of a push in each of these trials [N], of one second, at any time and in any direction."""

    def __post_init__(self) -> None:
        if self.stiffness not in ("diagonal", "isotropic"):
            raise InvalidArgumentError(f"stiffness has to be 'diagonal' or 'isotropic', got {self.stiffness!r}")
        if self.execution not in ("open", "closed", "passive"):
            raise InvalidArgumentError(f"execution has to be 'open', 'closed' or 'passive', got {self.execution!r}")
        for name in ("sensor_noise", "pushes"):
            number(name, getattr(self, name), "finite and at least 0", lambda std: 0 <= std < math.inf)
        self.start = torch.tensor(self.setup.start, dtype=torch.float64)
        self.goal = torch.zeros(2, dtype=torch.float64)
        self.via_points = torch.tensor(self.setup.via_points, dtype=torch.float64)
        mass = PointMass(mass=1.0, damping=1.0, force=self.force())
        self.feedback = self.execution != "open"
        self.plant = ImpedanceControlled(mass, form=self.form, low=self.low, high=self.high)
        if self.execution == "passive":
            self.plant = PassiveControlled(mass, None, low=self.low, high=self.high)

    @property
    def noisy(self) -> bool:
        """Whether there is sensor noise or a push."""
        return bool(self.sensor_noise or self.pushes)

    def tried(self, policy: GMRPolicy) -> Plant | None:
        """The point mass and its controller, with noise of its own for each trial."""
        if self.chance is None or not self.noisy:
            return self.plant
        x0, n_steps, dt = self.motion()
        plant = copy.copy(self.plant)
        assert isinstance(plant, ImpedanceControlled | PassiveControlled)
        drawn = disturbances.draw(
            (*policy.batch_shape, *x0.shape),
            n_steps,
            dt,
            sensor=self.sensor_noise,
            push=self.pushes,
            generator=self.chance,
        )
        plant.disturbance = moved(drawn, policy.A.device, policy.A.dtype)
        return plant

    @abstractmethod
    def force(self) -> Force:
        """The external force."""

    def default_demonstrations(self) -> Demonstrations:
        """Three imperfect motions along the arch."""
        return arch_demonstrations(self.bias)

    def policy(self) -> GMRPolicy:
        """The imitated motion with the stiffness that was demonstrated (Eq. 34), or else the constant s⁰."""
        return with_stiffness(self.mixture, 2, 2, self.stiffness_dim, self.initial_stiffness)

    @property
    def stiffness_dim(self) -> int:
        """Q, one for each axis or one for both."""
        return 2 if self.stiffness == "diagonal" else 1

    def motion(self) -> Motion:
        """The motion from the one start."""
        return Motion(self.start, round(self.setup.duration / DT), DT)

    def effort(self, path: Rollout) -> tuple[Tensor, Tensor]:
        """Acceleration and stiffness of each step of each trajectory `(*batch, *points, T)`, not weighted."""
        applied = path.plant.stiffness[..., 1:, :]
        return costs.acceleration_steps(path.v), torch.linalg.vector_norm(applied, dim=-1)

    def diagnostics(self, path: Rollout) -> dict[str, Tensor]:
        """Share of clamped stiffness, mean stiffness, and energy that its changes inject, `(*batch, *points)`."""
        assert isinstance(self.plant, ImpedanceControlled | PassiveControlled)
        said = {
            "stiffness/clamped": clamped_share(path, self.plant),
            "stiffness/mean": path.plant.stiffness[..., 1:, :].mean((-2, -1)),
        }
        return said if self.execution == "passive" else {**said, "stiffness/injected_energy": injected_energy(path)}

    def scene(self) -> Scene:
        """Start, goal and via-points."""
        return Scene(self.start[None], self.goal, {"via-points": self.via_points}, unit=self.setup.unit)
