"""The options of the digging task, which need none of the packages that the task itself needs."""

from __future__ import annotations

from typing import Literal

from tasks.base import Task
from tasks.settings import SearchSettings
from torchds.errors import InvalidArgumentError

LOW, HIGH = 50.0, 700.0  # N/m, bounds of the applied stiffness, those of the authors' robot
SECONDS = 15.0
WEIGHING = 0.5  # s at the end in which the gravel is weighed


class DiggingOptions(Task):
    """Learn to shovel gravel with a simulated KUKA LWR (section 6).

    Raises:
        InvalidArgumentError: a stiffness outside the bounds, unknown grains, no time or threads.
    """

    name = "lwr_digging"
    differentiable = False
    cpu_only = True  # MuJoCo is
    search = SearchSettings(
        n_updates=10,
        n_rollouts=8,
        control_weight=1e-12,
        mean_speed=0.008,
        std=0.01,
        mean_stiffness=60.0,
        spread=(0.015, 0.015, 0.15),
        stiffness_spread=100.0,
        elite="nominal",
    )

    initial_stiffness: float = 150.0
    """Uniform stiffness before learning, s⁰ [N/m]."""
    grains: Literal["fine", "coarse"] = "fine"
    """The bed: 285 grains of 4.5 to 7.5 mm radius, or 86 of 9 to 14 mm for tests."""
    seconds: float = SECONDS
    """Duration of the motion; the task's own demonstrations are stretched with it."""
    threads: int = 2
    """Threads that share the roll-outs of a batch; the results do not depend on them."""
    seed: int = 0
    """Seed of the beds; each trial has another one."""

    def __post_init__(self) -> None:
        if not LOW <= self.initial_stiffness <= HIGH:
            raise InvalidArgumentError(
                f"initial_stiffness has to be within [{LOW:g}, {HIGH:g}] N/m, got {self.initial_stiffness}"
            )
        if self.grains not in ("fine", "coarse"):
            raise InvalidArgumentError(f"grains has to be 'fine' or 'coarse', got {self.grains!r}")
        if not self.seconds > WEIGHING or self.threads < 1 or self.seed < 0:
            raise InvalidArgumentError(
                f"seconds has to be above {WEIGHING}, threads at least 1 and seed at least 0, got {self.seconds}, "
                f"{self.threads} and {self.seed}"
            )
