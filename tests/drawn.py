"""A small drawn problem, for tests of what is done with one."""

import math

from tasks.sketch import Problem


def stroke(shift=0.0, n=50):
    """An S from left to right, `[t, x1, x2]`."""
    rows = []
    for i in range(n):
        u = i / (n - 1)
        rows.append([2.0 * u, -0.8 + 1.6 * u, 0.4 * math.sin(2 * math.pi * u) + shift * (1 - u)])
    return rows


def problem(**fields):
    learner = {"optimizer": "pibb", "exploration": "homogeneous", "rollouts": 6, "runs": 2, "updates": 4}
    usual = {"strokes": [stroke(), stroke(0.05)], "samples": 41, "unit": "m", "learners": [learner]}
    return Problem(**{"name": "An S!", "via_points": [[-0.3, 0.3]], **usual, **fields})
