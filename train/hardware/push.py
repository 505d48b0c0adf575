"""The same push in open loop, in closed loop and under passive control: `python -m train push`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchds import Demonstrations, GMRPolicy, Rollout, fit_stable, load_lasa, plotting, rollout
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled
from torchds.plants import Plant, PointMass
from train.tables import aligned

MASS, STIFFNESS, ALONG, ACROSS = 1.0, 100.0, 20.0, 20.0  # kg, N/m, N s/m; critical damping is 20 N s/m too
FORCE, BEGIN, END = (0.0, 250.0), 2.0, 2.4  # mN, since lengths are in mm; s
DT, SECONDS = 0.01, 12.0


@dataclass
class Push:
    """Push a point mass that follows a learned stable motion, in each execution; draw the motions and print where they end."""

    motion: str = "Angle"
    """Of the LASA set."""
    path: Path = Path("logs/push.png")
    """The figure."""

    def main(self) -> None:
        """Fit, push, draw and print."""
        demos = load_lasa(self.motion, 3, scale=0.5, duration=8.0).every(10)
        policy = fit_stable(demos, n_components=4).policy
        paths = pushed(policy, demos[0].x[0])
        self.path.parent.mkdir(parents=True, exist_ok=True)
        plotting.save(self.path, figure(demos, policy, paths), dpi=80)
        print(
            aligned(("execution", "away from the motion after the push", "away from the goal at the end"), rows(paths))
        )


def push(t: float, x: Tensor, v: Tensor) -> Tensor:
    """The force at time t."""
    return x.new_tensor(FORCE) * (BEGIN <= t < END)


def executions() -> dict[str, tuple[Plant, bool]]:
    """Plant and feedback by name."""
    mass = PointMass(MASS, 0.0, push)
    return {
        "open loop": (ImpedanceControlled(mass, STIFFNESS), False),
        "closed loop": (ImpedanceControlled(mass, STIFFNESS), True),
        "passive": (PassiveControlled(mass, ALONG, ACROSS), True),
    }


def pushed(policy: GMRPolicy, x0: Tensor) -> dict[str, Rollout]:
    """The roll-outs by name of the execution."""
    with torch.no_grad():
        return {
            name: rollout(policy, x0, round(SECONDS / DT), DT, plant=plant, feedback=feedback)
            for name, (plant, feedback) in executions().items()
        }


def rows(paths: dict[str, Rollout]) -> list[tuple[str, float, float]]:
    """For each execution how far the push led away from the open loop's reference, and how far the end is from the goal's."""
    planned = paths["open loop"].reference
    at = round(END / DT)
    return [
        (name, float((path.x[at] - planned[at]).norm()), float((path.x[-1] - planned[-1]).norm()))
        for name, path in paths.items()
    ]


def figure(demos: Demonstrations, policy: GMRPolicy, paths: dict[str, Rollout]) -> Figure:
    """One map for each execution: field, demonstrations, the motion, and where it was pushed."""
    made = Figure(figsize=(14, 5.5), layout="constrained")
    tracks = [path.x for path in paths.values()]
    xlim, ylim = plotting.limits(*tracks, *(d.x for d in demos))
    for axes, (name, path) in zip(made.subplots(1, len(paths)), paths.items(), strict=True):
        axes.set(xlim=xlim, ylim=ylim)
        plotting.field(axes, policy)
        plotting.demonstrations(axes, demos)
        plotting.trajectories(axes, path.x, color="#c0392b", label="the mass")
        during = slice(round(BEGIN / DT), round(END / DT) + 1)
        plotting.trajectories(axes, path.x[during], color="black", label="while it is pushed", lw=3.5)
        plotting.finish_map(axes, name, "mm")
    return made
