"""The same tick as one compiled function (numba).

Stability: experimental.
"""

from __future__ import annotations

import math

import numpy as np

from torchds.control.plain import ACCELERATION, SPEED, WORKSPACE, Step
from torchds.control.plan import Plan
from torchds.errors import MissingPackageError

try:
    import numba
except ImportError as error:
    raise MissingPackageError("numba", "fast", "Controller(compiled=True)") from error


def step(plan: Plan) -> Step:
    """See `torchds.control.plain.step`."""
    K, D, O, Q = plan.sizes
    numbers, work = plan.numbers, np.empty(D + K + D)
    call = _tick

    def tick(base: np.ndarray, before: np.ndarray, row: np.ndarray) -> int:
        return call(numbers, K, D, O, Q, work, base, before, row)  # type: ignore[no-any-return]

    row = np.zeros(D + O + Q)
    tick(np.zeros(D), row[D : D + O], row)  # compiled now, not in the loop
    return tick


@numba.njit(error_model="numpy", fastmath={"reassoc", "contract"})
def _tick(numbers, K, D, O, Q, work, base, before, row):
    shift, low, high = 4, 4 + D, 4 + 2 * D
    center = 4 + 3 * D
    factors = center + D
    offset = factors + K * D * D
    log_scale = offset + K * D
    rows = log_scale + K
    highest = -np.inf
    for d in range(D):
        work[d] = base[d] - numbers[shift + d]
        work[D + K + d] = work[d] - numbers[center + d]
    for k in range(K):
        square = 0.0
        for j in range(k * D, (k + 1) * D):
            z = numbers[offset + j]
            for d in range(D):
                z += numbers[factors + j * D + d] * work[D + K + d]
            square += z * z
        work[D + k] = numbers[log_scale + k] - 0.5 * square
        highest = max(highest, work[D + k])
    total = 0.0
    for k in range(K):
        work[D + k] = math.exp(work[D + k] - highest)
        total += work[D + k]
    finite = True
    for o in range(O + Q):
        y, at = 0.0, rows + o * K * (D + 1)
        for k in range(K):
            expert = numbers[at + k * (D + 1) + D]
            for d in range(D):
                expert += numbers[at + k * (D + 1) + d] * work[d]
            y += work[D + k] * expert
        row[D + o] = y / total
        finite = finite and math.isfinite(row[D + o])
    if not finite:
        return -1
    dt, fastest, most, share, cut = numbers[0], numbers[1], numbers[2], numbers[3], 0
    speed, size = 0.0, 0.0
    for o in range(O):
        row[D + o] *= share
        if o < D:
            speed += row[D + o] * row[D + o]
    speed = math.sqrt(speed)
    if speed > fastest:
        for o in range(O):
            row[D + o] *= fastest / speed
        cut = SPEED
    for d in range(D):
        size += (row[D + d] - before[d]) ** 2
    size = math.sqrt(size)
    if size > most:
        for o in range(O):
            row[D + o] = before[o] + (row[D + o] - before[o]) * (most / size)
        cut |= ACCELERATION
    for d in range(D):
        end = base[d] + row[D + d] * dt
        inside = min(max(end, numbers[low + d]), numbers[high + d])
        if inside != end:
            row[D + d] = (inside - base[d]) / dt
            cut |= WORKSPACE
        row[d] = inside
    return cut
