"""What a comparison leaves behind: a page, tables, a figure, and TensorBoard's hyper-parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchds import plotting
from torchds.monitor.events import Events
from train.folder import make_folder, write_text
from train.statistics import of_costs
from train.tables import markdown, write_csv

REFERENCE = "pibb"  # whose final cost the others are held to

COLORS = {
    "pibb": "black",
    "pi2": "black",
    "pi2cma": "#e69f00",
    "surrogate": "#c2185b",
    "nes": "#8a3a1a",
    "cma": "#8fd694",
    "cobyqa": "#1f5fa8",
    "finite_differences": "#4bb3e8",
    "adam": "#c8201e",
    "sgd": "#f08a7e",
    "lbfgs": "#6d1b1b",
}
OTHERS = ("#1f5fa8", "#c2185b", "#e69f00", "#8fd694")  # of rows that were added


@dataclass(frozen=True)
class Outcome:
    """One optimizer on one problem.

    Attributes:
        problem: what was learned.
        label: of the optimizer, "..., trajectory" where it worked along the motion.
        record: the content of results.json; empty where the method was refused.
        factor: on its first step; None where it was not chosen here.
        tuned: median final cost of the tuning runs by factor.
        random: whether runs differ.
        gradient: whether it saw gradients.
        refused: why there is no result.
    """

    problem: str
    label: str
    record: dict[str, Any] = field(default_factory=dict)
    factor: float | None = None
    tuned: dict[float, float] = field(default_factory=dict)
    random: bool = True
    gradient: bool = False
    refused: str = ""

    @property
    def coordinates(self) -> str:
        """What it searched along: "plain", "trajectory", or the name of an exploration of the user."""
        kind = self.label.partition(", ")[2]
        return "plain" if kind in ("", "added") else kind

    def quartiles(self) -> np.ndarray:
        """`(3, U+1)` quartiles and median (in the middle) of the cost over runs; what is not a number counts as infinite."""
        return of_costs(self.record["cost"], axis=1)

    def reaches(self, level: float) -> int | None:
        """Roll-outs until the median is at `level` for the first time; None if never."""
        below = np.flatnonzero(self.quartiles()[1] <= level)
        return self.record["rollouts"][below[0]] if len(below) else None


HEAD = (
    "optimizer",
    "gradients",
    "factor",
    "initial",
    "final median",
    "q1",
    "q3",
    "roll-outs",
    "to PI^BB's final",
    "forward-equivalents",
    "failed",
    "runs",
    "seconds",
)


def number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}" if math.isfinite(value) else "∞"


def cells(row: Outcome, level: float | None) -> list[str]:
    """One line of a table."""
    if row.refused:
        return [row.label, *["—"] * (len(HEAD) - 1)]
    q1, median, q3 = row.quartiles()
    reached = None if level is None else row.reaches(level)
    unreached = "—" if level is None else "never"
    return [
        row.label,
        "yes" if row.gradient else "no",
        "—" if row.factor is None else f"{row.factor:.2g}",
        number(median[0]),
        number(median[-1]),
        number(q1[-1]),
        number(q3[-1]),
        str(row.record["rollouts"][-1]),
        unreached if reached is None else str(reached),
        str(row.record["forward_equivalents"][-1]),
        str(sum(row.record["failed"])),
        str(len(row.record["cost"][-1])) if row.random else "1, deterministic",
        f"{row.record['seconds']:.0f}",
    ]


def by_problem(rows: Iterable[Outcome]) -> dict[str, list[Outcome]]:
    """Rows in the order of the problems' first appearance."""
    found: dict[str, list[Outcome]] = {}
    for row in rows:
        found.setdefault(row.problem, []).append(row)
    return found


def reference_level(rows: Sequence[Outcome]) -> float | None:
    """PI^BB's final median, as tuned; None without such a row."""
    level = [row.quartiles()[1][-1] for row in rows if row.label == REFERENCE and not row.refused]
    return float(level[0]) if level else None


def table(rows: Sequence[Outcome]) -> str:
    """The Markdown table of one problem, the lowest final median first, and what was refused below it."""
    level = reference_level(rows)
    ordered = sorted(rows, key=lambda row: math.inf if row.refused else row.quartiles()[1][-1])
    text = markdown(HEAD, [cells(row, level) for row in ordered])
    reasons = [f"- {row.label}: {row.refused}" for row in rows if row.refused]
    return text + ("\n\nCannot be had:\n\n" + "\n".join(reasons) if reasons else "")


def choices(rows: Sequence[Outcome]) -> str:
    """The median final cost of the tuning runs by factor."""
    factors = sorted({factor for row in rows for factor in row.tuned})
    if not factors:
        return "No tuning: one factor was given."
    head = ["problem", "optimizer", *(f"× {factor:.2g}" for factor in factors), "chosen"]
    lines = []
    for row in rows:
        if row.tuned:
            tried = [number(row.tuned[factor]) for factor in factors]
            lines.append([row.problem, row.label, *tried, f"{row.factor:.2g}"])
    return markdown(head, lines)


TUNED = (
    "Every method's first step (width of noise, rate, or trust region) was tuned by one factor over the grid {factors}, by "
    "the median final cost of {tuning_runs} runs on seeds of their own. Where nothing is random there is one run, and the "
    "choice is made on the very run that is reported: that favours those rows. Nothing else was tuned for any row."
)
REPORTED = (
    "cobyqa, lbfgs and adam report the best point tried (adam, where costs are noisy, the present one), cma and nes the mean, "
    "sgd and finite_differences the present one."
)


def page(rows: Sequence[Outcome], options: dict[str, Any], versions: dict[str, str]) -> str:
    """The report; `options` it was made with, `noise_std`, `factors` and `tuning_runs` among them where there were any."""
    noise = options.get("noise_std", 0.0)
    noisy = (
        f" The cost of each trial carries normal noise of {noise:g} times the initial cost; the costs below are those without "
        "noise. The gradients of adam, sgd and lbfgs come from the simulation and know nothing of it."
        if noise
        else ""
    )
    tuned = ""
    if len(options.get("factors", ())) > 1:
        factors = ", ".join(f"{factor:.2g}" for factor in options["factors"])
        tuned = TUNED.format(factors=factors, tuning_runs=options["tuning_runs"]) + " "
    parts = [
        "# Comparison of optimizers",
        "Costs are those of the policy without noise, control cost included: medians and quartiles over the runs of a row, all "
        "of which start from the same policy. Roll-outs are counted per run; the evaluations that draw the curves are not part "
        f"of them.{noisy}",
        "Plain rows search with noise, or in coordinates, homogeneous in task space, each parameter by itself; trajectory rows "
        "along the motion, which needs the model of the reference motion (not of the plant). Rows with gradients "
        "differentiate the whole simulation, the plant and the cost: no robot gives that.",
        "Forward-equivalents: a roll-out counts as one, a roll-out with its gradient as four, the Jacobian of the reference "
        "motion as two (once for searches in fixed coordinates, in every update for pibb and pi2). Seconds are those of all "
        "runs of a row in one batch on one core.",
        f"{tuned}{REPORTED}",
    ]
    for problem, members in by_problem(rows).items():
        parts += [f"## {problem}", table(members)]
    parts += ["![Learning curves](curves.png)"]
    if "factors" in options:
        parts += ["## Tuning", choices(rows)]
    parts += ["## Made by", ", ".join(f"{name} {value}" for name, value in {**options, **versions}.items())]
    return "\n\n".join(parts) + "\n"


def colors(rows: Sequence[Outcome]) -> dict[str, str]:
    """One colour for one optimizer, in all panels."""
    names = dict.fromkeys(row.label.split(",")[0] for row in rows)
    spare = iter(OTHERS * len(names))
    return {name: COLORS.get(name) or next(spare) for name in names}


def curves(rows: Sequence[Outcome]) -> Figure:
    """Median cost against roll-outs, a row of panels per problem: plain on the left, along the motion beside it."""
    shown = [row for row in rows if not row.refused]
    problems, color = by_problem(shown), colors(rows)
    kinds = sorted({row.coordinates for row in shown} or {"plain"}, key=lambda kind: (kind != "plain", kind))
    figure = Figure(figsize=(2 + 5.2 * len(kinds), 0.8 + 3.6 * max(len(problems), 1)), layout="constrained")
    panels = figure.subplots(max(len(problems), 1), len(kinds), sharey="row", squeeze=False)
    for (problem, members), line in zip(problems.items(), panels, strict=False):
        for axes, kind in zip(line, kinds, strict=True):
            chosen = [row for row in members if row.coordinates == kind]
            draw(axes, chosen, color, reference_level(members))
            axes.set_title(f"{problem}: {'along the motion' if kind == 'trajectory' else kind}", fontsize=10)
            axes.set_xlabel("roll-outs")
        line[0].set_ylabel("cost without noise")
        limit(line[0], members)
    pairs = (zip(*axes.get_legend_handles_labels(), strict=True) for axes in panels.flat)
    handles = {label: line for each in pairs for line, label in each}
    figure.legend(list(handles.values()), list(handles), loc="outside right center", fontsize=9, frameon=False)
    return figure


def dashes(row: Outcome) -> str:
    """Colours tell optimizers of one kind of line apart: dashed with gradients, dots for PI² and for rows that were added."""
    name = row.label.split(",")[0]
    return "--" if row.gradient else "-." if name == "pi2" else "-" if name in COLORS else ":"


def draw(axes: Axes, rows: Sequence[Outcome], color: dict[str, str], level: float | None) -> None:
    """Medians as lines, quartiles as bands."""
    for row in rows:
        q1, median, q3 = row.quartiles()
        name, x = row.label.split(",")[0], row.record["rollouts"]
        label, width = name + " (gradients)" * row.gradient, 2.4 if name == REFERENCE else 1.5
        axes.plot(x, median, dashes(row), color=color[name], lw=width, label=label)
        axes.fill_between(x, q1, np.where(np.isfinite(q3), q3, median), color=color[name], alpha=0.12, lw=0)
    if level is not None and math.isfinite(level):
        axes.axhline(level, color="black", lw=0.8, ls=":", label="final median of PI^BB, plain")
    axes.grid(alpha=0.3)


def limit(axes: Axes, rows: Sequence[Outcome]) -> None:
    """The scale of all panels of a problem: one of logarithms where all medians are positive; what diverges leaves it."""
    q1, medians = (np.concatenate([row.quartiles()[i] for row in rows]) for i in (0, 1))
    low, high = q1.min(), max(row.quartiles()[1][0] for row in rows)
    if (medians > 0).all():
        plotting.log_scale(axes)
        low, high = min(axes.get_ylim()[0], 0.7 * medians.min()), 3 * high
    else:
        low, high = low - 0.05 * (high - low), high + 0.5 * (high - low)
    if low < high < math.inf:
        axes.set_ylim(low, high)


def write(folder: Path, rows: Sequence[Outcome], options: dict[str, Any], versions: dict[str, str]) -> str:
    """Write report.md, table.csv, curves.csv, curves.png and TensorBoard files; return the report."""
    text = page(rows, options, versions)
    write_text(folder / "report.md", text)
    kept = [row for row in rows if not row.refused]
    table = [
        [problem, *cells(row, reference_level(members)), row.refused]
        for problem, members in by_problem(rows).items()
        for row in members
    ]
    write_csv(folder / "table.csv", ["problem", *HEAD, "refused"], table)
    points = [
        [row.problem, row.label, *point]
        for row in kept
        for point in zip(row.record["rollouts"], *row.quartiles().tolist(), strict=True)
    ]
    write_csv(folder / "curves.csv", ["problem", "optimizer", "roll-outs", "q1", "median", "q3"], points)
    plotting.save(folder / "curves.png", curves(rows))
    for i, row in enumerate(kept):
        make_folder(folder / f"{i:03d}")
        with Events(folder / f"{i:03d}") as board:
            level = reference_level([other for other in kept if other.problem == row.problem])
            reached = None if level is None else row.reaches(level)
            metrics = {
                "hparam/final_cost_median": float(row.quartiles()[1][-1]),
                "hparam/rollouts_to_reference": math.inf if reached is None else reached,
                "hparam/forward_equivalents": row.record["forward_equivalents"][-1],
                "hparam/seconds": row.record["seconds"],
            }
            named = {"problem": row.problem, "optimizer": row.label, "gradient": str(row.gradient)}
            board.options({**named, "factor": row.factor or 0.0})
            board.scalars(metrics, row.record["rollouts"][-1])
    return text
