"""The numbers of a policy and of its bounds, in the one array that every form of the tick reads.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np

from torchds.errors import InvalidArgumentError

NEEDED = ("_center", "factors", "_offset", "_log_scale", "A", "b")


class Cut(IntFlag):
    """What was cut from a tick; several of them may be."""

    SPEED = 1
    ACCELERATION = 2
    WORKSPACE = 4


class Plan(NamedTuple):
    """Names for the parts of one array of float64; each is a view, so that what is written to it counts from the next tick.

    Attributes:
        numbers: all of them, in the order of the fields below.
        sizes: K, D, O, Q.
        limits: `(4,)` time step [s], largest speed, largest change of velocity in a tick, share of the speed that is left.
        shift: `(D,)` how far the field is moved.
        low: `(D,)` of the workspace, minus infinity for none.
        high: `(D,)`.
        center: `(D,)` c, where distances are taken from.
        factors: `(K D, D)` W_k with Σ_k⁻¹ = W_kᵀ W_k.
        offset: `(K D,)` W_k (c − μ_k).
        log_scale: `(K,)` log of π_k |W_k|.
        rows: `(O + Q, K (D + 1))` one row for each output.
    """

    numbers: np.ndarray
    sizes: tuple[int, int, int, int]
    limits: np.ndarray
    shift: np.ndarray
    low: np.ndarray
    high: np.ndarray
    center: np.ndarray
    factors: np.ndarray
    offset: np.ndarray
    log_scale: np.ndarray
    rows: np.ndarray


def plan(values: Mapping[str, Any], dt: float) -> Plan:
    """The plan of one policy without bounds.

    Args:
        values: arrays by the names that they have in a `GMRPolicy`.
        dt: time step [s].

    Raises:
        InvalidArgumentError: not one policy, or one of fewer velocities than inputs.
    """
    if missing := [name for name in NEEDED if name not in values]:
        raise InvalidArgumentError(f"a controller needs a GMRPolicy, got something without {', '.join(missing)}")
    A, b = values["A"], values["b"]
    if A.ndim != 3 or b.ndim != 2:
        raise InvalidArgumentError(
            f"a controller runs one policy, got a batch of {A.shape[:-3] or b.shape[:-2]}; give one of them, policy[i]"
        )
    (K, O, D), Q = A.shape, 0
    if O < D:
        raise InvalidArgumentError(f"a policy of {D} inputs has to have as many velocities or more, got {O}")
    if "stiffness_A" in values:
        A, b = np.concatenate([A, values["stiffness_A"]], 1), np.concatenate([b, values["stiffness_b"]], 1)
        Q = A.shape[1] - O
    rows = np.moveaxis(np.concatenate([A, b[..., None]], -1), 0, 1)  # (O + Q, K, D + 1)
    infinite = np.full(D, np.inf)
    gating = [values[name] for name in ("_center", "factors", "_offset", "_log_scale")]
    parts = [np.array([dt, np.inf, np.inf, 1.0]), np.zeros(D), -infinite, infinite, *gating, rows]
    shapes = [(4,), (D,), (D,), (D,), (D,), (K * D, D), (K * D,), (K,), (O + Q, K * (D + 1))]
    numbers = np.concatenate([np.asarray(part, np.float64).ravel() for part in parts])
    if not np.isfinite(numbers[4 + 3 * D :][numbers[4 + 3 * D :] != -np.inf]).all():  # log 0 is of padding
        raise InvalidArgumentError("the numbers of the policy have to be finite")
    views = np.split(numbers, np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1])
    return Plan(numbers, (K, D, O, Q), *(view.reshape(shape) for view, shape in zip(views, shapes, strict=True)))
