"""Figures of fields, motions and learning curves, drawn into matplotlib axes that the caller owns.

Stability: experimental.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchds.demonstrations import Demonstrations
from torchds.errors import MissingPackageError
from torchds.files import write_atomically
from torchds.policy import GMRPolicy

try:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse
except ImportError as error:
    raise MissingPackageError("matplotlib", "plot", "drawing figures") from error

# One colour for one kind of thing, in all figures.
FIELD = "#9db7d5"
DEMONSTRATION = "#e8a33d"
GAUSSIAN = "#b03a8c"
BEFORE = "#7a7a7a"
AFTER = "#c8201e"
TERMS = ("#1f5fa8", "#2a9d5c", "#8d6cc3", "#c98a1b", "#4bb3c2", "#8a5a3c")


def limits(*tracks: Tensor, margin: float = 0.12) -> tuple[tuple[float, float], tuple[float, float]]:
    """Axis limits around all finite points of 2-D tracks `(..., 2)`, with a relative margin."""
    points = torch.cat([t.detach().double().reshape(-1, 2) for t in tracks])
    points = points[points.isfinite().all(-1)]
    low, high = points.amin(0), points.amax(0)
    pad = margin * (high - low).clamp_min(1e-9).max()
    (x0, y0), (x1, y1) = (low - pad).tolist(), (high + pad).tolist()
    return (x0, x1), (y0, y1)


@torch.no_grad()
def field(axes: Axes, policy: GMRPolicy, *, resolution: int = 40) -> None:
    """The velocity of a 2-D policy as streamlines over the axes' present limits (Fig. 1)."""
    xs, ys = (np.linspace(*lim, resolution) for lim in (axes.get_xlim(), axes.get_ylim()))
    grid = np.stack(np.meshgrid(xs, ys), -1)
    v = policy(torch.as_tensor(grid, dtype=policy.means.dtype, device=policy.means.device)).cpu().numpy()
    axes.streamplot(xs, ys, v[..., 0], v[..., 1], color=FIELD, linewidth=0.7, arrowsize=0.7, density=1.1, zorder=1)


def gaussians(axes: Axes, policy: GMRPolicy, *, label: str | None = "Gaussians (1 sd)") -> None:
    """The gating's Gaussians as ellipses of one standard deviation in the first two inputs."""
    for k, (mean, covariance) in enumerate(zip(policy.means.cpu(), policy.covariances.cpu(), strict=True)):
        values, vectors = np.linalg.eigh(covariance[:2, :2].numpy())
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        width, height = 2 * np.sqrt(values[::-1])
        ellipse = Ellipse(
            (float(mean[0]), float(mean[1])), width, height, angle=angle, fill=False, ec=GAUSSIAN, lw=1.6, zorder=4
        )
        ellipse.set_label(label if k == 0 and label else "_nolegend_")
        axes.add_patch(ellipse)


def demonstrations(axes: Axes, demos: Demonstrations) -> None:
    """Demonstrated positions in the first two dimensions."""
    for i, demo in enumerate(demos):
        label = "demonstrations" if i == 0 else "_nolegend_"
        axes.plot(*demo.x[:, :2].T.cpu(), color=DEMONSTRATION, lw=1.6, ls=(0, (5, 2)), zorder=2, label=label)


def trajectories(axes: Axes, x: Tensor, *, color: str, label: str, lw: float = 2.2, alpha: float = 1.0) -> None:
    """Tracks `(*batch, T+1, D)` in the first two dimensions, with one entry in the legend."""
    tracks = x.detach().cpu()[..., :2].reshape(-1, *x.shape[-2:-1], 2)
    for i, track in enumerate(tracks):
        axes.plot(*track.T, color=color, lw=lw, alpha=alpha, zorder=5, label=label if i == 0 else "_nolegend_")


def markers(axes: Axes, starts: Tensor, goal: Tensor, via_points: Mapping[str, Tensor]) -> None:
    """Starts as squares, the goal as a star, sets of via-points as crossed circles."""
    axes.plot(*starts[:, :2].T.cpu(), "s", color="black", ms=8, zorder=7, label="start")
    axes.plot(*goal[:2, None].cpu(), "*", color="black", ms=14, zorder=7, label="goal")
    for (name, points), cross in zip(via_points.items(), ("x", "+", "1", "2"), strict=False):
        x, y = points[:, :2].T.cpu()
        axes.plot(x, y, "o", mfc="none", mec="black", ms=11, mew=1.5, zorder=7, label=name)
        axes.plot(x, y, cross, color="black", ms=8, mew=1.5, zorder=7)


def walls(axes: Axes, segments: Tensor) -> None:
    """Walls `(W, 2, D)` in the first two dimensions, as thick lines."""
    for i, segment in enumerate(segments[..., :2].cpu()):
        label = "walls" if i == 0 else "_nolegend_"
        axes.plot(*segment.T, color="black", lw=4, solid_capstyle="round", zorder=6, label=label)


def finish_map(axes: Axes, title: str, unit: str = "", names: Sequence[str] = ("x1", "x2")) -> None:
    """Equal aspect, axis labels with the unit, title, and the legend below the map."""
    axes.set_aspect("equal")
    suffix = f" [{unit}]" if unit else ""
    axes.set_xlabel(names[0] + suffix)
    axes.set_ylabel(names[1] + suffix)
    axes.set_title(title)
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=4.5, ncols=3, frameon=False)


def learning_curves(axes: Axes, rollouts: Sequence[int], curves: Mapping[str, Any], *, total: str = "total") -> None:
    """Cost terms against roll-outs: median over runs and the band between the quartiles.

    Args:
        axes: to draw into.
        rollouts: `[U+1]` roll-outs spent.
        curves: name -> `[U+1][runs]` costs; the one called `total` is drawn in front, in black. The scale is
            logarithmic unless a cost is negative.
        total: the name of the sum.
    """
    colors = iter(TERMS)
    for name, values in curves.items():
        q1, median, q3 = np.nanquantile(np.asarray(values, dtype=float), [0.25, 0.5, 0.75], axis=1)
        is_total = name == total
        color = "black" if is_total else next(colors)
        label = name.replace("_", "-")
        axes.plot(rollouts, median, color=color, lw=2.4 if is_total else 1.5, zorder=5 if is_total else 3, label=label)
        axes.fill_between(rollouts, q1, q3, color=color, alpha=0.16, lw=0)
    positive = all(np.nanmin(np.asarray(values, dtype=float)) >= 0 for values in curves.values())
    axes.set_yscale("log" if positive else "linear")
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
