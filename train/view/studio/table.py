"""What is seen of the plane."""

from __future__ import annotations

import torch
from torch import Tensor

from tasks.sketch import Problem
from torchds import plotting

Window = tuple[float, float, float, float]  # left, right, low, high

TABLE: Window = (-1.0, 1.0, -0.625, 0.625)
SMALL = 0.1  # what fills less of the width than this share is looked at from nearer
FEW = 5  # places that say nothing about size
FINEST = 1e-9  # width of what is looked at, in units or as a share of the largest coordinate: numbers end there


def points(problem: Problem) -> Tensor:
    """`(n, 2)` all places in a problem."""
    places = [row[1:] for stroke in problem.strokes for row in stroke]
    places += [*problem.via_points, *(end for wall in problem.walls for end in wall)]
    places += [place for place in (problem.start, problem.goal) if place is not None]
    for region in problem.regions:
        places += [tuple(x + side * region["radius"] for x in region["center"]) for side in (-1, 1)]
    return torch.tensor(places, dtype=torch.float64).reshape(-1, 2)


def seen(places: Tensor, before: Window) -> Window:
    """What is shown of the plane: as before where all `places` `(n, 2)` are in it and fill it, else what they need.

    Few places, as often as they may be there, say nothing about size: they get a usual table around them.
    """
    if not len(places):
        return TABLE
    size = float((places.amax(0) - places.amin(0)).max())
    few = len(places.unique(dim=0)) < FEW or size < FINEST * max(1.0, float(places.abs().max()))
    for left, right, low, high in (before, TABLE):
        corners = torch.tensor([[left, low], [right, high]], dtype=torch.float64)
        inside = bool(((places >= corners[0]) & (places <= corners[1])).all())
        if inside and (few or size >= SMALL * (right - left)):
            return left, right, low, high
    (left, right), (low, high) = plotting.limits(places)
    if few:
        x, y = (left + right) / 2, (low + high) / 2
        left, right = min(left, x + TABLE[0]), max(right, x + TABLE[1])
        low, high = min(low, y + TABLE[2]), max(high, y + TABLE[3])
    return left, right, low, high


def near(place: Tensor, window: Window) -> bool:
    """Whether a place `(2,)` is less than a window's width beside it."""
    left, right, low, high = window
    x, y = place.tolist()
    return left - (right - left) <= x <= right + (right - left) and low - (right - left) <= y <= high + (right - left)


def widened(window: Window, shape: float) -> Window:
    """The same with as much beside it as a table of this shape shows, width by height."""
    left, right, low, high = window
    width, height = max(right - left, shape * (high - low)), max(high - low, (right - left) / shape)
    x, y = (left + right) / 2, (low + high) / 2
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2
