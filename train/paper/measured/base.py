"""Learning runs, finished, and what is measured of all of them."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from train.learning.learner import Learner
from train.options import options_for
from train.paper.measured.digging import Experiment


class Setting(NamedTuple):
    """What a measurement is asked for.

    Attributes:
        runs: learning runs of each sample, in one batch.
        seed: of the exploration noise.
        experiment: the digging experiment, finished, begun or not there.
    """

    runs: int
    seed: int
    experiment: Experiment


@cache
def learned(task: str, runs: int, seed: int, **options: Any) -> Learner:
    """`runs` finished learning runs of a task in one batch, learned once for all figures and claims that need them.

    Args:
        task: its name.
        runs: learning runs.
        seed: of the exploration noise.
        **options: fields of the task's options that differ from its defaults.
    """
    return Learner(options_for(task, runs=runs, seed=seed, **options)).learn()


def course(learner: Learner, term: str | None = None) -> np.ndarray:
    """The noise-free cost `(U+1, runs)` after each update, of one term or in total."""
    history = learner.history
    return np.asarray(history.cost if term is None else history.terms[term])


def early_share(values: np.ndarray) -> np.ndarray:
    """How much of the fall of `values` `(U+1, runs)` the first quarter of the updates brings `(runs,)`; a line has 0.25."""
    quarter = (len(values) - 1) // 4
    return (values[0] - values[quarter]) / (values[0] - values[-1])


def via_distances(x: Tensor, points: Tensor) -> Tensor:
    """Smallest distance of motions `x` `(..., T+1, D)` to each via-point `(L, D)`, `(..., L)`."""
    return (x[..., 1:, None, :] - points).norm(dim=-1).amin(-2)


def extent(x: Tensor) -> float:
    """The diagonal of the box around motions `(..., D)`."""
    points = x.reshape(-1, x.shape[-1])
    return float((points.amax(0) - points.amin(0)).norm())
