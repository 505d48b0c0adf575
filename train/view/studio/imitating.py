"""A drawing becomes a system, in a process of its own."""

from __future__ import annotations

import time
import warnings
from functools import partial
from typing import NamedTuple

from torch import Tensor

from tasks.sketch import Problem, Sketch
from torchds import GMRPolicy
from torchds.errors import DemonstrationWarning
from train.view.studio.worker import Pipe, said


class Imitation(NamedTuple):
    """A drawing as a system.

    Attributes:
        policy: the imitated one.
        motion: `(T+1, 2)` from the start of the problem.
        verdict: of its certificate.
        margin: the guaranteed rate of convergence [1/s]; negative where the condition is violated.
        findings: what is suspicious about the demonstrations, as sentences.
        seconds: that the fit took.
    """

    policy: GMRPolicy
    motion: Tensor
    verdict: str
    margin: float
    findings: tuple[str, ...]
    seconds: float


def imitate(pipe: Pipe) -> None:
    """Answer each `(number, problem)` with `(number, Imitation or Failed)`."""
    while True:
        number, problem = pipe.next()
        pipe.send((number, said(partial(imitated, problem))))


def imitated(problem: Problem) -> Imitation:
    """The fit of a drawing.

    Raises:
        TorchdsError: nothing is drawn, or what is drawn cannot be fitted.
    """
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DemonstrationWarning)  # the findings say the same
        findings = problem.demonstrations().check()
        task = Sketch.of(problem)()
        policy = task.policy()
        motion = task.rollout(policy).x.detach()
        certificate = policy.certificate(task.scene().goal, task.P)
    return Imitation(
        policy,
        motion.reshape(-1, *motion.shape[-2:])[0],
        certificate.verdict,
        float(certificate.margin),
        tuple(finding.message for finding in findings),
        time.perf_counter() - began,
    )
