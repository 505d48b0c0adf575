"""A tick with numpy alone: no array is made, and as few calls as there can be.

Stability: experimental.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from torchds.control.plan import Cut, Plan

Step = Callable[[np.ndarray, np.ndarray, np.ndarray], int]
"""(x `(D,)`, velocity before `(O,)`, row `(D + O + Q,)` to write [x, v, s] to) -> what was cut, or −1 if it was not finite."""

SPEED, ACCELERATION, WORKSPACE = int(Cut.SPEED), int(Cut.ACCELERATION), int(Cut.WORKSPACE)


def step(plan: Plan) -> Step:
    """The tick of a plan: v = Σ_k h_k(x) (A_k x + b_k) (Eq. 1-3), cut to the bounds, and x + v dt (Eq. 4)."""
    K, D, O, _ = plan.sizes
    limits, shift, center, factors, offset = plan.limits, plan.shift, plan.center, plan.factors, plan.offset
    log_scale, rows, low, high = plan.log_scale, plan.rows, plan.low, plan.high
    position = np.ones(D + 1)  # [x, 1]
    x, away, z, h, change = position[:D], np.empty(D), np.empty(K * D), np.empty(K), np.empty(O)
    halves = np.repeat(-0.5 * np.eye(K), D, 1)  # sums the squares of each component
    features, column, ones = np.empty((K, D + 1)), h[:, None], np.ones(K)
    flat = features.reshape(-1)
    subtract, multiply, add, divide, dot, exp = np.subtract, np.multiply, np.add, np.divide, np.dot, np.exp
    isfinite, hypot, dist, inf = math.isfinite, math.hypot, math.dist, math.inf

    def tick(base: np.ndarray, before: np.ndarray, row: np.ndarray) -> int:
        subtract(base, shift, x)
        subtract(x, center, away)
        dot(factors, away, z)
        add(z, offset, z)
        multiply(z, z, z)
        dot(halves, z, h)
        add(h, log_scale, h)
        subtract(h, h[h.argmax()], h)
        exp(h, h)
        multiply(column, position, features)
        y = row[D:]
        dot(rows, flat, y)
        divide(y, dot(h, ones), y)
        now = y.tolist()  # few numbers: Python is faster with them than a call of numpy
        if not isfinite(sum(now)):
            return -1
        v, cut = y[:O], 0
        dt, fastest, most, share = limits.tolist()
        if share != 1.0:
            multiply(v, share, v)
            now = y.tolist()
        if fastest < inf and (speed := hypot(*now[:D])) > fastest:
            multiply(v, fastest / speed, v)
            now, cut = y.tolist(), SPEED
        if most < inf and (size := dist(now[:D], before.tolist()[:D])) > most:
            subtract(v, before, change)
            multiply(change, most / size, change)
            add(before, change, v)
            cut |= ACCELERATION
        end = row[:D]
        multiply(y[:D], dt, end)
        add(base, end, end)
        if bounded and not all(a <= b <= c for a, b, c in zip(lows, end.tolist(), highs, strict=True)):
            np.clip(end, low, high, end)
            divide(subtract(end, base, away), dt, v[:D])
            cut |= WORKSPACE
        return cut

    lows, highs = low.tolist(), high.tolist()
    bounded = any(isfinite(edge) for edge in lows + highs)
    return tick
