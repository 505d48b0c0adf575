"""The gating of a policy for one state, a part of compiled loops. `axes` and `experts` have D and K entries (`compiling.run`).

Stability: experimental.
"""

from __future__ import annotations

import math

import numpy as np

from torchds.kernels.compiling import piece


@piece
def clamp(value, limit):
    """`value` cut to ±`limit`; not a number stays that."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value


@piece
def whitened(axes, k, j, x, center, factors, offset, limit):
    """Entry j of L_k⁻¹ (x − μ_k), from a distance to the center that is cut to ±`limit`."""
    a = offset[k * len(axes) + j] + 0.0
    for d in range(len(axes)):
        a += factors[k, j, d] * clamp(x[d] - center[d], limit)
    return a


@piece
def expert(axes, row, k, h, x):
    """What component k says in one output: its part of the row times h [x, 1], nothing for h = 0, however far x is."""
    D = len(axes)
    y = row[k * (D + 1) + D] * h
    for d in range(D):
        y += row[k * (D + 1) + d] * (h * x[d])
    return y


@piece
def activate(axes, experts, x, center, factors, offset, log_scale, limit, h):
    """Write h_k(x) of Eq. 2 to `h`, as `GMRPolicy.gating` has it: distances are cut only where their squares are infinite."""
    D, K = len(axes), len(experts)
    highest, far = -np.inf, False
    for d in range(D):
        if not abs(x[d] - center[d]) <= limit:
            far = True
    for k in range(K):
        square = 0.0
        for j in range(D):
            a = offset[k * D + j] + 0.0
            for d in range(D):
                a += factors[k, j, d] * (x[d] - center[d])
            square += a * a
        if far or not square <= limit * limit:
            square = 0.0
            for j in range(D):
                a = clamp(whitened(axes, k, j, x, center, factors, offset, limit), limit)
                square += a * a
        h[k] = log_scale[k] - 0.5 * square
        if h[k] > highest:
            highest = h[k]
    total = 0.0
    for k in range(K):
        h[k] = math.exp(h[k] - highest)
        total += h[k]
    scale = 1.0 / total
    for k in range(K):
        h[k] *= scale
