"""Section 3: policy search on via-points, from one start and from two (Figs 1 to 4)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from torch import Tensor

import tasks
from train.learning.learner import Learner
from train.options import options_for
from train.paper.measured.base import learned

SHAPES = ("N", "P")


def letter(shape: str, runs: int, seed: int, **options: object) -> Learner:
    """The via-point task with one letter, learned."""
    return learned("via_point", runs, seed, shape=shape, **options)


@cache
def uncontrolled(shape: str, runs: int, seed: int) -> Learner:
    """The same, learned without a control cost."""
    task = tasks.make("via_point", shape=shape)
    task.search = replace(task.search, control_weight=0.0)
    return Learner(options_for("via_point", runs=runs, seed=seed, shape="N" if shape == "N" else "P"), task).learn()


def asymmetry(x: Tensor) -> Tensor:
    """Mean distance `(*batch)` between the right motion and the mirror image of the left one, `x` `(*batch, 2, T+1, 2)`."""
    mirrored = x[..., 0, :, :] * x.new_tensor([-1.0, 1.0])
    return (x[..., 1, :, :] - mirrored).norm(dim=-1).mean(-1).detach()
