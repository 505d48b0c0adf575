"""The layers of the table and the lines of the chart, as plain numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from torch import Tensor

from torchds import plotting
from train.view.studio.state import Studio
from train.view.studio.table import TABLE, Window, widened

COLUMNS = 28  # of arrows
LONGEST = 0.8  # arrow, in distances between two of them
DASHED = "dashed"  # lines of the second learner


def plain(x: Tensor | np.ndarray, table: Window = TABLE) -> Any:
    """Nested lists of numbers, short enough to be sent often, exact enough for what is seen of the plane."""
    digits = 4 - math.floor(math.log10((table[1] - table[0]) / 2))
    return np.round(np.nan_to_num(np.asarray(x, dtype=float)), digits).tolist()


def scenery(studio: Studio, shape: float) -> dict[str, Any]:
    """All that was drawn and placed."""
    p, task = studio.problem, studio.task
    scene = None if task is None else task.scene()
    return {
        "view": widened(studio.table, shape),
        "unit": p.unit,
        "strokes": [[row[1:] for row in stroke] for stroke in p.strokes],
        "via": p.via_points,
        "walls": p.walls,
        "regions": [[*region["center"], region["radius"]] for region in p.regions],
        "start": p.start or [] if scene is None else plain(scene.starts[0], studio.table),
        "goal": p.goal or [] if scene is None else plain(scene.goal, studio.table),
    }


def imitated(studio: Studio) -> dict[str, Any]:
    """The system that the drawing became: its motion and its Gaussians."""
    if studio.imitation is None:
        return {"imitated": [], "gaussians": []}
    policy = studio.imitation.policy
    ellipses = plotting.outlines(policy, 36)
    closed = np.concatenate([ellipses, ellipses[:, :1]], 1)
    return {"imitated": [plain(studio.imitation.motion, studio.table)], "gaussians": plain(closed, studio.table)}


def learned(studio: Studio, index: int, shape: float) -> dict[str, Any]:
    """What a side tries and has learned, and the field of its policy, or else of the imitated one."""
    layers: dict[str, Any] = {"field": field(studio, index, shape), "trials": [], "motion": []}
    picture = studio.fresh(index)
    if picture is not None:
        layers["trials"] = [path for trials in picture.trials for path in plain(trials, studio.table)]
        layers["motion"] = plain(picture.motion, studio.table)
    return layers


def field(studio: Studio, index: int, shape: float) -> list[Any]:
    """Arrows, from and to."""
    policy = studio.policy(index)
    if policy is None:
        return []
    left, right, low, high = widened(studio.table, shape)
    grid, v = plotting.velocities(policy, (left, right), (low, high), COLUMNS, round(COLUMNS / shape))
    x, v = grid.reshape(-1, 2), v.reshape(-1, v.shape[-1])[:, :2]
    speed = np.linalg.norm(v, axis=-1, keepdims=True)
    usual = np.nanmedian(speed) or 1.0
    length = LONGEST * (right - left) / COLUMNS
    arrows = length * v / np.maximum(speed, usual)
    return plain(np.stack([x - arrows / 2, x + arrows / 2], 1), (left, right, low, high))


def mass(studio: Studio) -> dict[str, Any] | None:
    """The mass that can be pulled at, with its trail."""
    pushed = studio.pushed
    if pushed is None:
        return None
    return {
        "at": plain(pushed.at, studio.table),
        "reference": plain(pushed.reference, studio.table),
        "hand": None if pushed.hand is None else plain(pushed.hand, studio.table),
        "trail": [plain(x, studio.table) for x in pushed.trail[::3]],
    }


def series(studio: Studio) -> list[dict[str, Any]]:
    """The learning curves of both sides by term, for a logarithmic axis."""
    lines = []
    for i, side in enumerate(studio.sides):
        picture = studio.fresh(i)
        if picture is None or side.problem is None:
            continue
        optimizer = side.problem.learners[0].get("optimizer", "pibb")
        terms = [name for name in picture.curves if name != "total"]
        for name, values in picture.curves.items():
            colour = "#1b2733" if name == "total" else plotting.TERMS[terms.index(name) % len(plotting.TERMS)]
            lines.append(
                {
                    "name": f"{name.replace('_', ' ')}, {'AB'[i]}: {optimizer}",
                    "type": "line",
                    "showSymbol": False,
                    "color": colour,
                    "lineStyle": {"type": DASHED if i else "solid", "width": 2.5 if name == "total" else 1.5},
                    "data": [
                        [n, float(f"{value:.4g}")]
                        for n, value in zip(picture.rollouts, values, strict=True)
                        if np.isfinite(value) and value > 0
                    ],
                }
            )
    return lines
