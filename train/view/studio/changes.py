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
    """Recorded motions beside what is drawn; of a very long one every second sample or fewer, with its last one.

    Raises:
        InvalidArgumentError: they are not in the plane, or not in the unit of the drawing.
    """
    if demos.dim != 2:
        raise InvalidArgumentError(f"the table is a plane: motions have to have 2 dimensions, got {demos.dim}")
    units = list(dict.fromkeys(unit for unit in demos.units if unit))
    if len(units) > 1:
        raise InvalidArgumentError(
            f"both axes of the table have one unit, got {' and '.join(units)}; scale one of them"
        )
    if problem.strokes and problem.unit and units and units != [problem.unit]:
        raise InvalidArgumentError(
            f"the drawing is in {problem.unit}, these motions are in {units[0]}; clear the drawing first, or scale the motions"
        )
    rows = [[(i * d.dt, *x) for i, x in enumerate(d.x.tolist())] for d in demos]
    rows = [each[:: -math.ceil(len(each) / MOST_SAMPLES)][::-1] for each in rows]
    return {"strokes": [*problem.strokes, *rows], "unit": problem.unit if problem.strokes else "".join(units)}


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
