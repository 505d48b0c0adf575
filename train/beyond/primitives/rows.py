"""What the table and the figure are made of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

from train.beyond.primitives.disturbed import Disturbance, Measures
from train.learning.learner import Learner


class Row(NamedTuple):
    """One system, learned in one way.

    Attributes:
        shape: the letter.
        system: "gmr" or "dmp".
        way: what learned it, by the name of the command.
        learner: after the last update.
        cost: `(U+1, runs)` of the task, without the control cost, whose unit is that of other parameters.
    """

    shape: str
    system: str
    way: str
    learner: Learner
    cost: np.ndarray


class Seen(NamedTuple):
    """What became of the policies of one system under one disturbance: places `(runs, points, T + late + 1, 2)`."""

    row: Row
    disturbance: Disturbance
    x: Tensor
    measured: Measures
