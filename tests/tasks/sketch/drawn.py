"""Strokes as a pointer gives them, for tests."""

import math

from tasks.sketch import Problem


def strokes(n=3, points=30):
    """S-shaped strokes in uneven time."""
    return [
        [
            (
                1.8 * (j + 0.3 * math.sin(7 * j + i)) / points,
                0.9 - 1.8 * j / points,
                0.4 * math.sin(6.28 * j / points) + 0.02 * i,
            )
            for j in range(points + 1)
        ]
        for i in range(n)
    ]


FULL = Problem(
    name="All of it",
    unit="m",
    strokes=strokes(),
    samples=41,
    smoothing=5,
    duration=2.0,
    components=3,
    condition="none",
    start=(0.8, 0.1),
    goal=(-0.9, 0.05),
    via_points=[(0.4, 0.5)],
    walls=[((-0.2, 0.2), (-0.2, 0.5))],
    regions=[{"center": (-0.4, -0.4), "radius": 0.1}],
    weights={"path_length": 0.01, "stiffness": 1e-6},
    body={"field": "divergent", "gain": 5.0},
    learners=[{"updates": 3, "noise": 0.1}, {"optimizer": "surrogate", "exploration": "trajectory"}],
)
