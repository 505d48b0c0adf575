"""The floor of the benchmark: the same algorithm as a program of its own in C++, compiled where a compiler is."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from tasks.via_point import ViaPoint
from torchds import GMRPolicy
from torchds.errors import TorchdsError
from torchds.exploration import Homogeneous
from train.benchmark.programs import printed

SOURCE = Path(__file__).with_name("floor.cpp")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-std=c++17")


class Floor(NamedTuple):
    """What the program took and found.

    Attributes:
        passes: seconds of N roll-outs, each time, from the fastest on.
        runs: seconds of a learning run, each time; empty where it made no updates.
        ends: the sum of the last state.
        before: cost of the policy before learning, and `after` it.
        after: see there.
    """

    passes: list[float]
    runs: list[float]
    ends: float
    before: float
    after: float


def compile_floor(folder: Path) -> Path | None:
    """The program in `folder`; None without a C++ compiler, or with one that fails, which is printed."""
    compiler = next(filter(None, map(shutil.which, ("g++", "clang++", "c++"))), None)
    if compiler is None:
        return None
    program = folder / "floor"
    try:
        printed([compiler, *FLAGS, SOURCE, "-o", program])
    except TorchdsError as error:
        print(error)
        return None
    return program


def run_floor(
    program: Path, task: ViaPoint, policy: GMRPolicy, n_rollouts: int, n_steps: int, n_updates: int, repeats: int
) -> Floor:
    """Let the program roll out and learn the task from `policy`, with its noise, control cost and decay.

    Raises:
        TorchdsError: it fails.
    """
    motion, std = task.motion(), Homogeneous(policy, mean_speed=task.search.mean_speed or 0.0).std()
    head = (
        policy.n_components,
        n_steps,
        motion.dt,
        n_rollouts,
        n_updates,
        repeats,
        10.0,
        task.search.control_weight,
        0.1,
    )
    log_scale = _log_scale(policy)
    numbers: list[Tensor] = []
    for k in range(policy.n_components):
        parts = (log_scale[k], policy.means[k], policy.factors[k], policy.A[k], policy.b[k], std["A"][k], std["b"][k])
        numbers += [part.detach().double().flatten() for part in parts]
    tail = (motion.x0, task.goal, torch.tensor(len(task.via_points)), task.via_points)
    numbers += [part.double().flatten() for part in tail]
    text = " ".join(f"{number:.17g}" for number in (*head, *torch.cat(numbers).tolist()))
    found = printed([program], input=text).splitlines()
    passes, runs, costs = ([float(word) for word in line.split()] for line in found)
    return Floor(passes, runs, *costs)


def _log_scale(policy: GMRPolicy) -> Tensor:
    """log π_k + log det of the root of the precision, `(K,)`: what stands before the square in Eq. 2, up to a constant."""
    return policy.priors.log() + policy.factors.diagonal(dim1=-2, dim2=-1).log().sum(-1)
