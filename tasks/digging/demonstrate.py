"""Record the demonstrations again: `python -m tasks.digging.demonstrate` writes `demonstrations/`, in a minute.

Five hand-made shovelling motions, each with way points and a pace of its own, drive the simulated arm through soil: a bed
lighter and more slippery than the gravel on which the motion is learned later. What is recorded is where the tool went, as
of a person who back-drives the robot with a firm hand; nothing is said about stiffness.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import torch

from tasks.digging.gravel import Gravel
from tasks.digging.simulation import WAY_POINTS, dig, scoop
from tasks.digging.worlds import Worlds
from torchds.files import write_atomically

FOLDER = Path(__file__).parent / "demonstrations"
SOIL = Gravel(density=1300.0, friction=0.6, seed=7)
N, SEED = 5, 3
HAND = 700.0  # N/m, the stiffness of the hand that guides the tool
STEP = 0.1  # s between samples
VARIATION = (0.010, 0.006, 0.04)  # standard deviation of way points: x [m], z [m], angle [rad]
SECONDS = (12.5, 14.5)  # shortest and longest motion


def motions(dt: float) -> list[torch.Tensor]:
    """The hand's N motions, each `(T+1, 3)`: x [m], z [m], angle [rad]."""
    generator = np.random.default_rng(SEED)
    varied = []
    for _ in range(N):
        points = WAY_POINTS + generator.normal(size=WAY_POINTS.shape) * np.array([0.0, *VARIATION])
        points[-1, 1:] = points[-2, 1:]  # held at the end
        varied.append(scoop(float(generator.uniform(*SECONDS)), dt, points))
    return varied


def main() -> None:
    """Record all N motions in one batch and write one file each."""
    torch.set_num_threads(1)
    hand = motions(SOIL.time_step)
    longest = max(len(motion) for motion in hand)
    held = torch.stack([torch.cat([m, m[-1:].expand(longest - len(m), -1)]) for m in hand])
    worlds = Worlds(SOIL, N, n_threads=2)
    recording = dig(worlds, held, torch.tensor(HAND, dtype=torch.float64), list(range(N)))
    every = round(STEP / SOIL.time_step)
    FOLDER.mkdir(exist_ok=True)
    for i, motion in enumerate(hand):
        pose = recording.pose[i, : len(motion) : every].numpy()
        table = np.column_stack([STEP * np.arange(len(pose)), pose])
        head = {"header": "time,x,z,angle", "comments": ""}
        write_atomically(FOLDER / f"{i + 1}.csv", partial(np.savetxt, X=table, fmt="%.5f", delimiter=",", **head))
    print(f"{N} demonstrations in {FOLDER}; loads {recording.load.tolist()} N, failed: {recording.failed.tolist()}")


if __name__ == "__main__":
    main()
