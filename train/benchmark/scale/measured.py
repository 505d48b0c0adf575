"""One run by several processes, timed; torchrun starts this module with a case, its updates, and the file to write."""

from __future__ import annotations

import os
import pickle
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import threadpoolctl
import torch
import torch.distributed as dist

from torchds import files
from train.benchmark.programs import printed
from train.learning.learner import Learner
from train.learning.processes import joined
from train.options import options_for
from train.statistics import median

PATIENCE = 600.0  # s
GATHERS = 50  # of which one is timed


class Case(NamedTuple):
    """What is learned.

    Attributes:
        task: of the training commands.
        options: of the run, but its updates.
        updates: as many as take a while.
    """

    task: str
    options: dict[str, Any]
    updates: int


CASES = {
    "N, 10 roll-outs": Case("via_point", {"rollouts": 10}, 50),
    "N, 1000 roll-outs": Case("via_point", {"rollouts": 1000}, 20),
    "N, 10 roll-outs, PI²": Case("via_point", {"rollouts": 10, "optimizer": "pi2"}, 50),
    "divergent field, 10 roll-outs": Case("divergent_field", {"rollouts": 10}, 50),
    "digging of 3 s, 10 roll-outs": Case(
        "lwr_digging", {"rollouts": 10, "grains": "coarse", "seconds": 3.0, "threads": 1}, 3
    ),
}


class Timing(NamedTuple):
    """Medians over the updates of a run.

    Attributes:
        update: seconds of an update, with the noise-free trial that is logged.
        busy: of these, processor time of the process that has most, which others on the machine do not change.
        together: of these, seconds from when the first process has its costs until it has those of all.
        gather: seconds of the same gather where nobody is waited for.
        messages: collective calls of an update.
        bytes: what one process sends in an update, before it goes to each of the others.
    """

    update: float
    busy: float
    together: float
    gather: float
    messages: int
    bytes: int


def timed(case: str, processes: int, updates: int | None = None) -> Timing:
    """Start that many processes and time their updates.

    Raises:
        TorchdsError: they fail.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "timing.json"
        launch = ["-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
        program = ["-m", "train.benchmark.scale.measured", case, str(updates or CASES[case].updates), str(path)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        printed([sys.executable, *launch, *program], env=environment)
        return Timing(**files.read_sealed(path))


def learn(case: Case, updates: int) -> Timing:
    """What each process does."""
    spent: list[tuple[float, Any]] = []
    gather: Any = dist.all_gather_object

    def watched(everyone: Any, said: Any, group: Any = None) -> None:
        began = time.perf_counter()
        gather(everyone, said, group)
        spent.append((time.perf_counter() - began, said))

    with joined(PATIENCE) as processes:
        learner = Learner(options_for(case.task, updates=updates + 1, **case.options), wrap=processes.share)
        learner.start()
        learner.update()  # compiles
        vars(dist)["all_gather_object"] = watched
        began = time.process_time()
        seconds = [learner.update() for _ in range(updates)]
        busy = (time.process_time() - began) / updates
        vars(dist)["all_gather_object"] = gather
        if processes.size == 1:
            return Timing(median(seconds), busy, 0.0, 0.0, 0, 0)
        together, said = median([seconds for seconds, _ in spent]), spent[-1][1]
        alone = []
        for _ in range(GATHERS):
            dist.barrier()
            began = time.perf_counter()
            gather([None] * processes.size, said)
            alone.append(time.perf_counter() - began)
        everyone: list[float] = [0.0] * processes.size
        gather(everyone, busy)
        # A gather of objects is two calls: how long they are, and what they are.
        return Timing(
            median(seconds), max(everyone), together, median(alone), 2 * len(spent) // updates, len(pickle.dumps(said))
        )


def main() -> None:
    """Time a case; the first process writes the file."""
    case, updates, path = sys.argv[1:]
    torch.set_num_threads(1)
    with threadpoolctl.threadpool_limits(1):
        timing = learn(CASES[case], int(updates))
    if int(os.environ["RANK"]) == 0:
        files.write_sealed(Path(path), timing._asdict())


if __name__ == "__main__":
    main()
