"""What the benchmark times, each row a function that does it once."""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch

import torchds
from tasks.via_point import ViaPoint
from torchds import GaussianMixture, GMRPolicy, rollout
from torchds.errors import LargestMixtureWarning, MissingPackageError
from torchds.exploration import TrajectorySpace
from torchds.kernels import available
from torchds.kernels.choice import Backend
from train.benchmark.programs import printed
from train.learning.learner import Learner
from train.options import LEARNERS, options_for

N_STEPS = 200
BATCHES = (10, 200, 4000)
ON_GPU = (*BATCHES, 100_000, 1_000_000)


class Row(NamedTuple):
    """One thing to time.

    Attributes:
        name: of what is done.
        call: does it once.
        floor: what the C++ program does in the same place: ("passes" | "runs", N); None where it has no such thing.
        share: how often the floor's work is done: 20 for 20 runs.
    """

    name: str
    call: Callable[[], object]
    floor: tuple[str, int] | None = None
    share: int = 1


def rows(task: ViaPoint, policy: GMRPolicy, device: str, updates: int) -> Iterator[Row]:
    """All rows; the call of one that this machine cannot make raises a TorchdsError or an OutOfMemoryError."""
    for n in BATCHES if device == "cpu" else ON_GPU:
        batch = policy.expand(n).requires_grad_(False)
        motion = task.motion()._replace(n_steps=N_STEPS)
        for backend in ("eager", "scan", "fused"):
            call = functools.partial(rollout, batch, *motion, backend=backend)
            alike = min(n, 4000)  # more take the floor as much longer: a million a quarter of a minute
            yield Row(f"{n} roll-outs of {N_STEPS} steps, {backend}", call, ("passes", alike), n // alike)
    for name, options in LEARNERS.items():
        for runs in (1, 20, 1000) if device == "cuda" and name == "pibb" else (1, 20):
            given = options_for("via_point", runs=runs, updates=updates, device=device, **options)
            floor = ("runs", given.rollouts or task.search.n_rollouts)
            yield Row(f"{runs} run(s) x {updates} updates, {name}", _learns(given), floor, runs)
    for name, optimizer in (("CMA-ES of the package cma", "cma"), ("score-function gradient", "nes")):
        given = options_for("via_point", optimizer=optimizer, updates=updates, device=device)
        yield Row(f"1 run(s) x {updates} updates, {name}", _learns(given), ("runs", task.search.n_rollouts))
    along = TrajectorySpace(policy.expand(1), *task.motion(), spread=0.5)
    yield Row("Jacobian of a motion (TrajectorySpace)", along.refresh_now)
    x = task.motion().x0
    with_rows = torch.no_grad()(policy.forward)
    yield Row("policy(x), one state", lambda: with_rows(x))
    if device == "cpu":
        yield from _arm()
        yield from _fits()


def _fits() -> Iterator[Row]:
    """Fits, and the import; they are made on the CPU."""
    motion = torchds.load_lasa("Angle", 7).every(4)
    few = torchds.load_lasa("Angle", 4).every(8)
    many = motion.stacked().x.repeat(58, 1)[:100_000]
    many = many + torch.randn(many.shape, generator=torch.Generator().manual_seed(0), dtype=many.dtype)
    yield Row("GaussianMixture.fit, 1750 samples, K = 4", lambda: GaussianMixture.fit(motion, 4))
    yield Row("GaussianMixture.fit, 1750 samples, K = 'bic'", lambda: _counted(motion))
    yield Row("GaussianMixture.fit, 100000 samples, K = 6", lambda: GaussianMixture.fit(many, 6))
    yield Row("fit_stable, one motion, P-QLF", lambda: torchds.fit_stable(few))
    imports = [sys.executable, "-c", "import torchds"]
    yield Row("import torchds, a new process", lambda: printed(imports))


def _arm() -> Iterator[Row]:
    """One call of the controller; none without the packages of the digging."""
    try:
        from tasks.digging import lwr
        from torchds.cartesian import CartesianImpedance
        from torchds.targets import PlaneReference
    except MissingPackageError:
        return
    x, z, angle = (torch.tensor([value], dtype=torch.float64) for value in (0.55, 0.2, -0.3))
    q, zero = lwr.posture(x, z, angle), torch.zeros(1, 7, dtype=torch.float64)
    wanted = PlaneReference(torch.stack([x, z], -1), angle, zero[:, :2], zero[:, 0])
    mass = torch.eye(7, dtype=torch.float64)[None]
    chain, posture, state = lwr.chain(), q[0], (q, zero, mass, zero)
    backends: tuple[Backend, ...] = ("fused", "eager") if available()["cpu"] else ("eager",)
    for backend in backends:
        control = CartesianImpedance(chain, posture, torque_limit=lwr.EFFORTS, backend=backend)
        for n, what in ((1, "one arm"), (64, "64 arms")):
            q, v, mass, bias = (part.expand(n, *part.shape[1:]).contiguous() for part in state)
            call = torch.inference_mode()(functools.partial(control, q, v, mass, bias, wanted, 300.0))
            yield Row(f"CartesianImpedance, {what} of seven joints, {backend}", call)


def _counted(motion: torchds.Demonstrations) -> None:
    with warnings.catch_warnings():  # here the largest is the best
        warnings.simplefilter("ignore", LargestMixtureWarning)
        GaussianMixture.fit(motion, "bic")


def _learns(options: Any) -> Callable[[], object]:
    """A run without the fit before it, which is the same each time."""
    task = options.make_task()
    task.policy()
    return lambda: Learner(options, task).learn()
