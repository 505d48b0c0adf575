"""What the pointer and the controls do to a problem: each returns the fields of its file that change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tasks.sketch import Problem
from tasks.sketch.problem import MOST_POINTS
from torchds import Demonstrations
from torchds.errors import InvalidArgumentError

FEWEST = 5  # places that make a motion
MOST_SAMPLES = 2000  # of a recorded motion
LISTS = {"via": "via_points", "walls": "walls", "regions": "regions", "strokes": "strokes"}

Point = Sequence[float]
Fields = dict[str, Any]


def stroke(problem: Problem, points: Sequence[Point]) -> Fields:
    """One more stroke of the pointer, `[t, x1, x2]` each, with any clock [s]; of very many points every second one or fewer."""
    begun = points[0][0]
    every = math.ceil(len(points) / MOST_POINTS)
    rows = [[round(t - begun, 4), x1, x2] for t, x1, x2 in points[::-every][::-1]]
    return {"strokes": [*problem.strokes, rows]}


def complete(points: Sequence[Point]) -> None:
    """Refuse a stroke that says nothing.

    Raises:
        InvalidArgumentError: it hardly went anywhere.
    """
    if len({tuple(point[1:]) for point in points}) < FEWEST:
        raise InvalidArgumentError("that was too short for a motion: keep the pointer down and draw on")


def recorded(problem: Problem, demos: Demonstrations) -> Fields:
    """Recorded motions beside what is drawn.

    Raises:
        InvalidArgumentError: they are not in the plane.
    """
    if demos.dim != 2:
        raise InvalidArgumentError(f"the table is a plane: motions have to have 2 dimensions, got {demos.dim}")
    longest = max(len(d.x) for d in demos)
    demos = demos.every(math.ceil(longest / MOST_SAMPLES)) if longest > MOST_SAMPLES else demos
    rows = [[[i * d.dt, *x] for i, x in enumerate(d.x.tolist())] for d in demos]
    unit = problem.unit if problem.strokes else demos.units[0]
    return {"strokes": [*problem.strokes, *rows], "unit": unit}


def placed(problem: Problem, kind: str, begin: Point, end: Point) -> Fields:
    """A via-point at `end`, a wall between both, or a forbidden disc around `begin`.

    Raises:
        InvalidArgumentError: a wall or a disc without a size.
    """
    if kind == "via":
        return {"via_points": [*problem.via_points, end]}
    if tuple(begin) == tuple(end):
        raise InvalidArgumentError("that needs two places: press at one, move, and let go at the other")
    if kind == "walls":
        return {"walls": [*problem.walls, [begin, end]]}
    return {"regions": [*problem.regions, {"center": begin, "radius": math.dist(begin, end)}]}


def dragged(problem: Problem, kind: str, index: int, at: Point) -> Fields:
    """The start, the goal or a via-point is elsewhere."""
    if kind == "via":
        return {"via_points": [at if i == index else point for i, point in enumerate(problem.via_points)]}
    return {kind: at}


def erased(problem: Problem, kind: str, index: int) -> Fields:
    """A stroke, a via-point, a wall or a region goes."""
    name = LISTS[kind]
    return {name: [item for i, item in enumerate(getattr(problem, name)) if i != index]}
