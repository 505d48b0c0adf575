"""The picture: learning curves, and motions that are pushed, held and begun elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from torchds import plotting
from train.beyond.primitives.rows import Row, Seen
from train.statistics import of_costs

LEARNERS = {"pibb": "black", "pi2": "#8a8a8a", "recommended": "#c2185b", "adam": "#e8a33d"}
SYSTEMS = {"gmr": ("dynamical system (GMR)", "#1f5fa8", "-"), "dmp": ("movement primitive (DMP)", "#d1561f", "--")}
PANELS = {
    "pushed": "Pushed at 2/5 of the motion",
    "held": "Held at 2/5 of the motion",
    "begun elsewhere": "Begun elsewhere",
}


def draw(rows: Sequence[Row], seen: Sequence[Seen]) -> Figure:
    """A line of panels for each letter."""
    shapes = list(dict.fromkeys(row.shape for row in rows))
    figure = Figure(figsize=(18, 0.8 + 4.6 * len(shapes)), layout="constrained")
    panels = figure.subplots(len(shapes), 1 + len(PANELS), squeeze=False)
    for shape, line in zip(shapes, panels, strict=True):
        draw_curves(line[0], [row for row in rows if row.shape == shape])
        line[0].set_title(f"{shape}: learning")
        for axes, (name, title) in zip(line[1:], PANELS.items(), strict=True):
            draw_motions(axes, [s for s in seen if s.row.shape == shape], name)
            axes.set_title(f"{shape}: {title[0].lower()}{title[1:]}")
    handles = [Line2D([], [], color=color, lw=2, label=name) for name, color in LEARNERS.items()]
    handles += [
        Line2D([], [], color="#444444", lw=2, ls=ls, label=f"{label}, learning") for label, _, ls in SYSTEMS.values()
    ]
    handles += [Line2D([], [], color=color, lw=2, label=label) for label, color, _ in SYSTEMS.values()]
    handles += [
        Line2D([], [], color="#9a9a9a", lw=2, ls=":", label="the same, undisturbed"),
        Line2D([], [], color="black", marker="o", mfc="white", ls="", label="via-points"),
        Line2D([], [], color="black", marker="*", ms=11, ls="", label="goal"),
        Line2D([], [], color="#444444", marker="x", ls="", label="where it is disturbed"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=10, frameon=False)
    return figure


def draw_curves(axes: Axes, rows: Sequence[Row]) -> None:
    """Medians and quartiles over runs, the system by the dashes."""
    for row in rows:
        q1, middle, q3 = of_costs(row.cost, axis=1)
        x, color = row.learner.history.rollouts, LEARNERS[row.way]
        axes.plot(x, middle, SYSTEMS[row.system][2], color=color, lw=1.8)
        axes.fill_between(x, q1, q3, color=color, alpha=0.1, lw=0)
    plotting.log_scale(axes)
    axes.set(xlabel="roll-outs", ylabel="cost of the task, without control cost")
    axes.grid(alpha=0.3)


def draw_motions(axes: Axes, seen: Sequence[Seen], name: str) -> None:
    """The run with the median cost of each system: every second direction, over what it does undisturbed."""
    for each in seen:
        order = np.argsort(each.row.cost[-1])
        run = int(order[(len(order) - 1) // 2])
        if each.disturbance.name == "none":
            axes.plot(*each.x[run, 0].numpy().T, ":", color="#9a9a9a", lw=2, zorder=1)
        if each.disturbance.name != name:
            continue
        _, color, _ = SYSTEMS[each.row.system]
        tracks = each.x[run, ::2].numpy()
        for track in tracks:
            axes.plot(*track.T, color=color, lw=1.2, alpha=0.85, zorder=2)
            place = track[each.disturbance.at + 1 if name == "pushed" else each.disturbance.at]
            axes.plot(*place, "x", color=color, ms=7, mew=1.8, zorder=4)
    scene = seen[0].row.learner.task.scene()
    for points in scene.via_points.values():
        axes.plot(*points.numpy().T, "o", mfc="white", mec="black", ms=7, zorder=3)
    axes.plot(*scene.goal.numpy(), "*", color="black", ms=12, zorder=3)
    axes.set(xlabel=f"x [{scene.unit}]", ylabel=f"y [{scene.unit}]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
