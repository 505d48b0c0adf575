"""What a stop condition, a force or a plant tells compiled code about itself: its scalar step.

Stability: experimental.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from torch import Tensor

# The steps that compiled code knows; see `torchds.kernels.cpu`.
NONE, OWN = 0, -1
BOUNDS, WALLS = 1, 2
CONSTANT, BEYOND, AWAY, AWAY_ALONG_NORMAL = 1, 2, 3, 4
IMPEDANCE = 1


class ScalarStep(NamedTuple):
    """One step for one roll-out and one point, in plain numbers, for `backend="fused"`.

    A stop condition, a force or a plant may have a method `scalar_step(n_axes, n_rows)` that returns one, for roll-outs of
    D = `n_axes` inputs and Q = `n_rows` stiffness rows; None where it cannot say, and the roll-out is eager. It has to do
    the same as the call on tensors.

    Attributes:
        function: written in the part of Python that numba compiles, with numpy arrays of one dimension, `p` the parameters,

            * of a stop condition, `f(p, x, x_next) -> bool`;
            * of a force, `f(p, t, x, v, force)`, which writes the D numbers of `force`;
            * of a plant, `f(p, before, after, x_before, x, v_before, v, stiffness, t, dt)`, which writes the plant's state
              after the step to `after`, where `before` is the one before it: the fields of the state one after the other.
              The others are those of `Command`; `stiffness` is empty for a policy without.

            A number stands for one of torchds' own.
        parameters: `(n,)`, or `(*points, n)` or `(*batch, *points, n)` where they differ: all numbers that it needs.
        force: of a plant, the external force that acts on it; None for none, or where `function` sees to it.
    """

    function: int | Callable[..., Any]
    parameters: Tensor
    force: ScalarStep | None = None


def own(part: Any, name: str) -> Callable[..., Any] | None:
    """The method of an object's class; None where it has none, or only passes on that of another object."""
    method = getattr(type(part), name, None)
    return None if method is None else functools.partial(method, part)
