"""A stand-in for a robot: executes the roll-outs in each folder that it reads a line about, and records them."""

import sys
from pathlib import Path

import numpy as np
import torch

from tasks.digging.task import LwrDigging

HEADER = "time [s],x [m],z [m],angle [rad],force_x [N],force_y [N],force_z [N]"


def main():
    torch.set_num_threads(1)
    task = LwrDigging(grains="coarse", seconds=float(sys.argv[1]), seed=int(sys.argv[2]), threads=1)
    for line in sys.stdin:
        folder = Path(line.strip())
        files = sorted(folder.glob("rollout-*.csv"))
        tables = torch.from_numpy(np.stack([np.loadtxt(file, delimiter=",", skiprows=1) for file in files]))
        done = task.execute(tables[..., 1:4].contiguous(), tables[:, :-1, 7].contiguous())
        force = torch.cat([done.force[:, :1], done.force], 1)  # nobody looks at the first
        for i, table in enumerate(torch.cat([tables[..., :1], done.pose, force], -1).numpy(), 1):
            np.savetxt(folder / f"recording-{i}.csv", table, "%.17g", ",", header=HEADER, comments="")
        print("executed", flush=True)


if __name__ == "__main__":
    main()
