"""Tables and figure of the LASA benchmark, beside the published numbers."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure

from torchds import Demonstrations, StableFit, plotting, rollout
from train.lasa.measures import Split
from train.lasa.published import PUBLISHED, PUBLISHED_SEDS
from train.tables import markdown, write_csv

Rows = Sequence[Mapping[str, Any]]

NAMES = {
    "gmr": "GMR by EM, A and b free",
    "none": "same fit without a condition",
    "seds": "SEDS (P = I)",
    "p-qlf": "P-QLF (P learned)",
}
# Measure -> heading, decimals, factor.
MEASURES = {
    "rmse": ("RMSE [mm/s]", 2, 1.0),
    "edot": ("ė", 4, 1.0),
    "dtwd": ("DTWD [mm]", 0, 1.0),
    "swept_area": ("swept area [mm²]", 0, 1.0),
    "grid": ("grid at goal [%]", 2, 100.0),
    "certified": ("certified [%]", 0, 100.0),
    "margin": ("margin [1/s]", 3, 1.0),
    "K": ("K", 1, 1.0),
    "seconds": ("fit [s]", 2, 1.0),
}
DEFINITIONS = """\
- Data: every 2nd of the 1000 samples, so 500 a demonstration; fits see every 4th of these. The goal is the origin.
- K: the number of Gaussians, by BIC, at most 15.
- RMSE: mean over samples of √(mean over dimensions of squared velocity errors), at the test demonstrations' positions.
- ė: mean over samples of 1 − cos of the angle between demonstrated and predicted velocity.
- DTWD: sum of Euclidean distances along the best dynamic time warping, no window, not divided by a number of samples; Euler
  steps of 0.01 s from the 20th sample until all reproductions of a motion are slower than 0.1 mm/s for 4 steps, at most 3000.
- Swept area: area between reproduction and demonstration from the 20th sample on, both resampled to equal distances.
- Grid at goal: share of 16 × 16 starts, over the demonstrations' box widened by 10 % a side, within 1 mm of the goal after at
  most 100 s (Euler steps of 0.01 s).
- Certified: fits with P A_k + A_kᵀ P ≺ 0 and b_k = −A_k x* for all k; margin: the smallest rate of convergence this guarantees.
- Fit: seconds per motion on one core, fitted in one batch; EM and the choice of K included, the same for all rows.
- ± is the standard deviation over motions and repetitions, each the mean over its test demonstrations. Measurements that the
  published evaluation makes too follow its definitions. Its own fits saw 2000 samples of a motion (SEDS), or 500 for the
  Gaussians and 1000 for the slopes (LPV-DS); these here saw 500."""


def values(rows: Rows, measure: str, **where: str) -> list[float]:
    """The values of a measure in the rows that match."""
    return [float(row[measure]) for row in rows if all(row[key] == value for key, value in where.items())]


def summary(measure: str, numbers: Sequence[float]) -> float:
    """The mean over fits; of margins the smallest."""
    return min(numbers) if measure == "margin" else statistics.fmean(numbers)


def cell(measure: str, numbers: Sequence[float], spread: bool) -> str:
    """Mean and, for errors, standard deviation as printed."""
    _, digits, factor = MEASURES[measure]
    text = f"{factor * summary(measure, numbers):.{digits}f}"
    with_spread = spread and len(numbers) > 1 and measure in ("rmse", "edot", "dtwd", "swept_area")
    return f"{text} ± {factor * statistics.pstdev(numbers):.{digits}f}" if with_spread else text


def page(rows: Rows, options: Mapping[str, Any], versions: Mapping[str, str], seconds: float) -> str:
    """The page of results in Markdown."""
    motions = list(dict.fromkeys(row["motion"] for row in rows))
    ours = [
        [NAMES[method], *(cell(m, values(rows, m, method=method), spread=True) for m in MEASURES)] for method in NAMES
    ]
    published = [
        [name, f"{r:.2f} ± {dr:.2f}", f"{e:.3f} ± {de:.3f}", f"{d} ± {dd}", *["–"] * (len(MEASURES) - 3)]
        for name, (r, dr, e, de, d, dd) in PUBLISHED.items()
    ]
    headings, align = [heading for heading, _, _ in MEASURES.values()], "l" + "r" * len(MEASURES)
    shown = ("rmse", "edot", "dtwd", "swept_area", "grid", "K")
    parts = [
        "# LASA benchmark\n",
        f"{len(motions)} motions, {options['repetitions']} repetition(s), {options['split']} split, first seed "
        f"{options['seed']}; test set. {seconds:.0f} s on one core ("
        + ", ".join(f"{k} {v}" for k, v in versions.items())
        + ").\n",
        markdown(["measured", *headings], ours, align) + "\n",
        markdown(["published, all 26 motions", *headings], published, align) + "\n",
        DEFINITIONS + "\n",
        "## By motion\n",
    ]
    for method, name in NAMES.items():
        lines = [
            [motion, *(cell(m, values(rows, m, method=method, motion=motion), spread=False) for m in shown)]
            for motion in motions
        ]
        heading = ["motion", *(MEASURES[m][0] for m in shown)]
        if method == "seds":
            heading.append("published RMSE")
            lines = [[*line, f"{PUBLISHED_SEDS[line[0]]:.2f}"] for line in lines]
        parts.append(f"### {name}\n\n" + markdown(heading, lines, align) + "\n")
    return "\n".join(parts)


def write_tables(folder: Path, rows: Rows) -> None:
    """fits.csv, one row a fit; by_method.csv and by_motion.csv, means over fits."""
    methods, motions = (list(dict.fromkeys(row[key] for row in rows)) for key in ("method", "motion"))
    means = {m: f"{m}_min" if m == "margin" else m for m in MEASURES}
    by_method = [
        {"method": method}
        | {means[m]: summary(m, values(rows, m, method=method)) for m in MEASURES}
        | {f"{m}_std": statistics.pstdev(values(rows, m, method=method)) for m in ("rmse", "edot", "dtwd")}
        for method in methods
    ]
    by_motion = [
        {"method": method, "motion": motion}
        | {means[m]: summary(m, values(rows, m, method=method, motion=motion)) for m in MEASURES}
        for method in methods
        for motion in motions
    ]
    for name, content in {"fits": rows, "by_method": by_method, "by_motion": by_motion}.items():
        write_csv(folder / f"{name}.csv", list(content[0]), [list(row.values()) for row in content])


@torch.no_grad()
def fields(motions: Sequence[str], split: Split, fit: StableFit, rows: Rows) -> Figure:
    """The fields of one repetition's fits with demonstrations and reproductions, and the numbers beside the published."""
    n_columns = 6
    n_rows = -(-(len(motions) + 4) // n_columns)  # the table takes the last four cells
    figure = Figure(figsize=(3.1 * n_columns, 3.2 * n_rows + 0.4), layout="constrained")
    grid = figure.add_gridspec(n_rows, n_columns)
    path = rollout(fit.policy, split.x[:, :, 0], 1000, 0.01, starts="per_policy").x
    for i, motion in enumerate(motions):
        axes = figure.add_subplot(grid[divmod(i, n_columns)])
        x, y = plotting.limits(path[i], *(demo.x for demo in (*split.train[i], *split.test[i])))
        half = max(x[1] - x[0], y[1] - y[0]) / 2
        axes.set_xlim(sum(x) / 2 - half, sum(x) / 2 + half)
        axes.set_ylim(sum(y) / 2 - half, sum(y) / 2 + half)
        plotting.field(axes, fit.policy[i])
        for demos, label, style in ((split.train[i], "training", "-"), (split.test[i], "test", (0, (4, 2)))):
            draw(axes, demos, label, style)
        plotting.trajectories(axes, path[i], color=plotting.AFTER, label="P-QLF, from the test starts", lw=1.3)
        axes.plot(*fit.goal[i, :, None], "*", color="black", ms=9, zorder=7, label="goal")
        rmse = values(rows, "rmse", method="p-qlf", motion=motion)[0]
        axes.set_title(f"{motion}: RMSE {rmse:.1f} mm/s", fontsize=9)
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=9, frameon=False)
    below = figure.add_subplot(grid[-1, -4:])
    below.axis("off")
    measured = [
        [
            f"this benchmark: {NAMES[method]}",
            *(cell(m, values(rows, m, method=method), True) for m in list(MEASURES)[:3]),
        ]
        for method in NAMES
    ]
    published = [
        [f"published: {name}", f"{r:.2f} ± {dr:.2f}", f"{e:.3f} ± {de:.3f}", f"{d} ± {dd}"]
        for name, (r, dr, e, de, d, dd) in PUBLISHED.items()
    ]
    drawn = below.table(
        cellText=measured + published,
        colLabels=["test set, mean ± standard deviation", "RMSE [mm/s]", "ė", "DTWD [mm]"],
        colWidths=[0.46, 0.18, 0.18, 0.18],
        loc="center",
        cellLoc="left",
    )
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(8)
    return figure


def draw(axes: Any, demos: Demonstrations, label: str, style: Any) -> None:
    """Demonstrations in one line style."""
    for i, demo in enumerate(demos):
        name = f"{label} demonstrations" if i == 0 else "_nolegend_"
        axes.plot(*demo.x.T, color=plotting.DEMONSTRATION, lw=1.1, ls=style, zorder=3, label=name)
