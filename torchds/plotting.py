"""Figures of fields, motions and learning curves, drawn into matplotlib axes that the caller owns.

Stability: stable.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchds import poses, quartiles
from torchds.arrays import Array, real
from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError, MissingPackageError
from torchds.files import write_atomically
from torchds.policy import GMRPolicy

try:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon
    from matplotlib.path import Path as Outline
    from matplotlib.patheffects import AbstractPathEffect, withStroke
    from matplotlib.ticker import Formatter, LogLocator, MaxNLocator
except ImportError as error:
    raise MissingPackageError("matplotlib", "plot", "drawing figures") from error

# One colour for one kind of thing, in all figures; the colour-blind tell apart those of one figure, see the tests.
FIELD = "#9db7d5"
DEMONSTRATION = "#e8a33d"
GAUSSIAN = "#b03a8c"
BEFORE = "#7a7a7a"
AFTER = "#c8201e"
FRAME = ("#c8201e", "#2a9d5c", "#1f5fa8")
TERMS = ("#1f5fa8", "#e69f00", "#2a9d5c", "#cc79a7", "#4bb3e8", "#8a3a1a")


def limits(*tracks: Array, margin: float = 0.12, dims: int = 2) -> tuple[tuple[float, float], ...]:
    """Axis limits around all finite points of tracks `(..., D)` in their first `dims` dimensions, with a relative margin.

    Where no point is finite, they are 0 and 1.
    """
    seen = (real("tracks", t, "(..., D)").detach().cpu().double() for t in tracks)
    points = torch.cat([x[..., :dims].reshape(-1, dims) for x in seen])
    points = points[points.isfinite().all(-1)]
    if not len(points):
        return ((0.0, 1.0),) * dims
    low, high = points.amin(0), points.amax(0)
    pad = margin * (high - low).clamp_min(1e-9).max()
    return tuple(zip((low - pad).tolist(), (high + pad).tolist(), strict=True))


def shown(axes: Axes, what: str, x: Array) -> Tensor:
    """The dimensions of `x` `(..., D)` that the axes have: the first two, or three of 3-D axes.

    Raises:
        InvalidArgumentError: `x` has fewer.
    """
    x, n = real(what, x, "(..., D)"), 3 if axes.name == "3d" else 2
    if x.shape[-1] < n:
        raise InvalidArgumentError(f"{what} of {x.shape[-1]} dimensions cannot be drawn into axes of {n}")
    return x.detach().cpu()[..., :n]


def check_plane(axes: Axes, what: str) -> None:
    """Refuse axes that are no plane."""
    if axes.name == "3d":
        raise InvalidArgumentError(
            f"{what} can be drawn in a plane only, got 3-D axes; draw trajectories and frames there"
        )


def check_single(what: str, batch_shape: Sequence[int]) -> None:
    """Refuse a batch of policies where one is drawn."""
    if batch_shape:
        raise InvalidArgumentError(
            f"{what} is that of one policy, got a batch {tuple(batch_shape)}; give one of it, policy[0]"
        )


def field(axes: Axes, policy: GMRPolicy, *, resolution: int = 40) -> None:
    """The velocity of a 2-D policy as streamlines over the axes' present limits (Fig. 1).

    Raises:
        InvalidArgumentError: 3-D axes, a policy of another number of inputs, or a batch of them.
    """
    check_plane(axes, "a field")
    grid, v = velocities(policy, axes.get_xlim(), axes.get_ylim(), resolution, resolution)
    xs, ys = grid[0, :, 0], grid[:, 0, 1]
    axes.streamplot(xs, ys, v[..., 0], v[..., 1], color=FIELD, linewidth=0.7, arrowsize=0.7, density=1.1, zorder=1)


def velocities(
    policy: GMRPolicy, xlim: tuple[float, float], ylim: tuple[float, float], nx: int, ny: int
) -> tuple[np.ndarray, np.ndarray]:
    """The field of a 2-D policy on a grid: points and velocities, each `(ny, nx, 2)`.

    Raises:
        InvalidArgumentError: a policy of another number of inputs, or a batch of them.
    """
    if policy.input_dim != 2:
        raise InvalidArgumentError(f"the field of a policy of two inputs can be drawn, got one of {policy.input_dim}")
    check_single("a field", policy.batch_shape)
    grid = np.stack(np.meshgrid(np.linspace(*xlim, nx), np.linspace(*ylim, ny)), -1)
    with torch.no_grad():
        v = policy(torch.as_tensor(grid, dtype=policy.means.dtype, device=policy.means.device)).cpu().numpy()
    return grid, v


def gaussians(axes: Axes, policy: GMRPolicy, *, label: str | None = "Gaussians (1 sd)") -> None:
    """The gating's Gaussians as ellipses of one standard deviation in the first two inputs.

    Raises:
        InvalidArgumentError: 3-D axes, a policy of one input, or a batch of policies that each have their own.
    """
    check_plane(axes, "Gaussians")
    shown(axes, "Gaussians", policy.means)
    for k, outline in enumerate(outlines(policy)):
        ellipse = Polygon(outline, closed=True, fill=False, ec=GAUSSIAN, lw=1.6, zorder=4)
        ellipse.set_label(label if k == 0 and label else "_nolegend_")
        axes.add_patch(ellipse)


def outlines(policy: GMRPolicy, n: int = 72) -> np.ndarray:
    """The ellipses of one standard deviation of the gating's Gaussians, `(K, n, 2)` points in the first two inputs.

    Raises:
        InvalidArgumentError: a batch of policies that each have their own.
    """
    check_single("a gating", policy.means.shape[:-2])
    turn = torch.linspace(0.0, 2 * math.pi, n + 1)[:-1]
    circle = torch.stack([turn.cos(), turn.sin()], -1).to(policy.means)
    roots = torch.linalg.cholesky(policy.covariances[:, :2, :2])
    points: np.ndarray = (policy.means[:, None, :2] + circle @ roots.mT).detach().cpu().numpy()
    return points


def demonstrations(axes: Axes, demos: Demonstrations) -> None:
    """Demonstrated positions in the dimensions of the axes, two or three."""
    for i, demo in enumerate(demos):
        label = "demonstrations" if i == 0 else "_nolegend_"
        axes.plot(
            *shown(axes, "demonstrations", demo.x).T, color=DEMONSTRATION, lw=1.6, ls=(0, (5, 2)), zorder=2, label=label
        )


def trajectories(axes: Axes, x: Array, *, color: str, label: str, lw: float = 2.2, alpha: float = 1.0) -> None:
    """Tracks `(*batch, T+1, D)` in the dimensions of the axes, two or three, with one entry in the legend."""
    tracks = shown(axes, "trajectories", x)
    for i, track in enumerate(tracks.reshape(-1, *tracks.shape[-2:])):
        axes.plot(*track.T, color=color, lw=lw, alpha=alpha, zorder=5, label=label if i == 0 else "_nolegend_")


def markers(axes: Axes, starts: Array, goal: Array, via_points: Mapping[str, Array]) -> None:
    """Starts as squares, the goal as a star, sets of via-points as circles with a cross of their own in each set."""
    rim: list[AbstractPathEffect] = [withStroke(linewidth=3.5, foreground="white")]  # they are seen on dark maps too
    axes.plot(*shown(axes, "starts", starts).T, "s", color="black", ms=8, zorder=7, label="start", path_effects=rim)
    axes.plot(
        *shown(axes, "a goal", goal)[:, None], "*", color="black", ms=14, zorder=7, label="goal", path_effects=rim
    )
    for i, (name, points) in enumerate(via_points.items()):
        (line,) = axes.plot(*shown(axes, "via-points", points).T, ls="", ms=11, mew=1.5, zorder=7, label=name)
        line.set(marker=crossed(i), markerfacecolor="none", markeredgecolor="black", path_effects=rim)


def crossed(i: int) -> Outline:
    """A circle with a cross, one marker as a whole, so that a legend shows it as it is drawn: ×, +, Y, and others by i."""
    arms, turn = ((4, 0.125), (4, 0.0), (3, 0.25), (3, 0.0))[i % 4]
    angles = 2 * np.pi * (np.arange(arms) / arms + turn)
    ends = 0.75 * np.stack([np.cos(angles), np.sin(angles)], -1)
    lines = [Outline(np.stack([np.zeros(2), end])) for end in ends]
    return Outline.make_compound_path(Outline.unit_circle(), *lines)


class PlainNumbers(Formatter):
    """0.01, 0.1, 1, 10 on an axis of logarithms, with 2 and 5 where less than two decades are seen, or else all ticks."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label of a tick."""
        low, high = sorted(self.axis.get_view_interval())  # type: ignore[union-attr]
        decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.log10(high) + 1)
        usual = np.outer(decades, (1, 2, 5) if high < 100 * low else (1,))
        if ((low <= usual) & (usual <= high)).sum() > 1 and not np.isclose(usual, x, atol=0).any():
            return ""
        return np.format_float_positional(float(f"{x:.6g}"), trim="-") if 1e-6 < x < 1e6 else f"{x:g}"


def log_scale(axes: Axes, which: str = "y") -> None:
    """Make an axis, "x" or "y", one of logarithms with plain numbers."""
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_formatter(PlainNumbers())
    axis.set_minor_locator(LogLocator(subs=list(range(2, 10))))
    axis.set_minor_formatter(PlainNumbers())


def frames(axes: Axes, x: Array, goal: Array, *, size: float, n: int = 8) -> None:
    """The frames of the tool along a motion of poses, axes in red, green and blue, into 3-D axes.

    Args:
        axes: 3-D ones.
        x: `(T+1, 6)` [p, r], see `torchds.poses`.
        goal: `(4,)` orientation at which r is zero, the scalar first.
        size: length of the axes [unit of the positions].
        n: how many, evenly along the way, on which a turn by one radian is `size` long; the first and the last among them.

    Raises:
        InvalidArgumentError: axes of a plane, or states that are no poses.
    """
    x = real("x", x)
    if axes.name != "3d" or x.ndim != 2 or x.shape[-1] != 6:
        raise InvalidArgumentError(f"frames need 3-D axes and states (T+1, 6), got {axes.name} and {tuple(x.shape)}")
    states = x.detach().cpu()
    step = states.diff(dim=0) * states.new_tensor([1.0, 1.0, 1.0, size, size, size])
    way = torch.cat([step.new_zeros(1), torch.linalg.vector_norm(step, dim=-1).cumsum(0)])
    chosen = states[(torch.linspace(0, 1, n).to(way)[:, None] * way[-1] - way).abs().argmin(-1)]
    turned = poses.matrix(chosen, real("goal", goal).detach().cpu())
    for i, (position, matrix) in enumerate(zip(chosen[:, :3], turned, strict=True)):
        for direction, color, name in zip(matrix.T, FRAME, "xyz", strict=True):
            ends = torch.stack([position, position + size * direction])
            label = f"{name} of the tool" if i == 0 else "_nolegend_"
            axes.plot(*ends.T, color=color, lw=1.5, zorder=6, label=label)


def walls(axes: Axes, segments: Array) -> None:
    """Walls `(W, 2, D)` in the first two dimensions, as thick lines.

    Raises:
        InvalidArgumentError: 3-D axes.
    """
    check_plane(axes, "walls")
    for i, segment in enumerate(real("segments", segments, "(W, 2, D)")[..., :2].cpu()):
        label = "walls" if i == 0 else "_nolegend_"
        axes.plot(*segment.T, color="black", lw=4, solid_capstyle="round", zorder=6, label=label)


def discs(axes: Axes, centres: Array, radii: Array, *, label: str = "forbidden") -> None:
    """Discs of `radii` `(R,)` around `centres` `(R, D)` in the first two dimensions, hatched, with one entry in the legend.

    Raises:
        InvalidArgumentError: 3-D axes, or not one radius for each centre.
    """
    check_plane(axes, "discs")
    middles, sizes = shown(axes, "centres", real("centres", centres, "(R, D)")), real("radii", radii, "(R,)").cpu()
    if middles.ndim != 2 or sizes.shape != middles.shape[:1]:
        raise InvalidArgumentError(
            f"centres and radii have to be (R, D) and (R,), got shapes {tuple(middles.shape)} and {tuple(sizes.shape)}"
        )
    for i, (middle, radius) in enumerate(zip(middles.tolist(), sizes.tolist(), strict=True)):
        disc = Circle(middle, radius, fc=(0, 0, 0, 0.08), ec="black", lw=1.2, hatch="//", zorder=3)
        disc.set_label(label if i == 0 else "_nolegend_")
        axes.add_patch(disc)


def small_map(*tracks: Array) -> tuple[Figure, Axes]:
    """A figure of 400 by 460 pixels and its axes, with limits around tracks `(..., D)`, to be finished by `finish_map`.

    Its room is shared out beforehand, which takes a third of the time of a layout that is fitted: for pictures in a series.
    """
    figure = Figure(figsize=(4.0, 4.6), dpi=100)
    figure.subplots_adjust(left=0.16, right=0.97, top=0.93, bottom=0.24)
    axes = figure.subplots()
    axes.set(**dict(zip(("xlim", "ylim"), limits(*tracks, margin=0.25), strict=True)))
    return figure, axes


def finish_map(axes: Axes, title: str, unit: str = "", names: Sequence[str] = ("x1", "x2", "x3")) -> None:
    """Equal aspect, axis labels with the unit, title, and the legend below the map."""
    axes.set_aspect("equal")
    suffix = f" [{unit}]" if unit else ""
    axes.set_xlabel(names[0] + suffix)
    axes.set_ylabel(names[1] + suffix)
    if axes.name == "3d":
        axes.set_zlabel(names[2] + suffix)  # type: ignore[attr-defined]
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):  # type: ignore[attr-defined]
            axis.set_major_locator(MaxNLocator(4))
            axis.labelpad = 8
    axes.set_title(title)
    below = 0.0 if axes.name == "3d" else 4.5  # 3-D axes have room for their labels within
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=below, ncols=3, frameon=False)


def learning_curves(axes: Axes, rollouts: Sequence[int], curves: Mapping[str, Any], *, total: str = "total") -> None:
    """Cost terms against roll-outs: median over runs and the band between the quartiles.

    A cost that is not finite, as of a run that failed, counts as infinite: curves and bands leave out where they are infinite.

    Args:
        axes: to draw into.
        rollouts: `[U+1]` roll-outs spent.
        curves: name -> `[U+1][runs]` costs; the one called `total` is drawn in front, in black. The scale is
            logarithmic unless a cost is negative.
        total: the name of the sum.
    """
    looks = itertools.cycle(itertools.product(("-", "--", ":"), TERMS))
    for name, values in curves.items():
        q1, median, q3 = quartiles.of_costs(values, axis=1)
        is_total = name == total
        style, color = ("-", "black") if is_total else next(looks)
        lw, zorder = (2.4, 5) if is_total else (1.5, 3)
        axes.plot(rollouts, median, style, color=color, lw=lw, zorder=zorder, label=name.replace("_", "-"))
        axes.fill_between(rollouts, q1, q3, color=color, alpha=0.16, lw=0)
    costs = np.concatenate([np.ravel(values) for values in curves.values()])
    costs = costs[np.isfinite(costs)]
    if (costs >= 0).all() and (costs > 0).any():
        log_scale(axes)
    axes.set_xlabel("roll-outs")
    axes.set_ylabel("cost of the policy without noise")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def save(path: str | Path, figure: Figure, dpi: int = 130) -> None:
    """Write a figure as .png, whole or not at all.

    Raises:
        FileError: the disk is full, read-only or gone; what was there before is unchanged.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    write_atomically(path, lambda stream: stream.write(buffer.getbuffer()))
