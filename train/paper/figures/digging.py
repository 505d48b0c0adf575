"""Figures 15 to 17: the digging experiment (section 6), as far as `python -m train digging` has made it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from torchds import plotting
from torchds.errors import InvalidArgumentError
from train.learning.figures import draw_curves
from train.paper.figures.base import Made
from train.paper.measured.digging import (
    SEARCH,
    SEARCHES,
    STARTS,
    TRIALS,
    UNIFORM,
    Experiment,
    Sample,
    best_uniform,
    budget,
    history,
    means,
    trials,
)
from train.statistics import below, delta, deviation, median, summary

COLORS = dict(zip(SEARCHES, (plotting.AFTER, plotting.GAUSSIAN), strict=True))
MARKERS = dict(zip(SEARCHES, ("x", "P"), strict=True))
COLUMNS = {  # of the table: what is measured, and its decimals
    "total cost": ("total", 2),
    "load [N]": ("gravel/load", 1),
    "force cost": ("force", 2),
    "peak force [N]": ("force/peak", 1),
    "mean stiffness [N/m]": ("stiffness/mean", 0),
}


def figure_15(experiment: Experiment) -> Made:
    """The scene, at three times of a learned motion."""
    _needed(experiment, history(experiment, "recommended", STARTS[0]) is not None)
    learner = experiment.learned("recommended", STARTS[0])
    learner.evaluate()
    assert learner.path is not None
    film = learner.task.film(learner.path, 31)
    assert film is not None
    seconds = learner.task.motion().n_steps * learner.task.motion().dt
    figure = Figure(figsize=(16, 4.4), layout="constrained")
    for axes, i in zip(figure.subplots(1, 3), (0, 15, 30), strict=True):
        axes.imshow(film[i])
        axes.set_title(f"t = {seconds * i / 30:.1f} s")
        axes.axis("off")
    load = float(learner.task.diagnostics(learner.path)["gravel/load"].median())
    return Made(
        figure,
        "The simulated KUKA LWR 4+ with a shovel, over a box of gravel: a motion learned from s⁰ = 150 N/m, before, while and "
        f"after it digs; {load:.1f} N lie on the shovel in the end. Grains move in the plane of the task; each is drawn as a "
        "row of pebbles across the blade.",
    )


def figure_16(experiment: Experiment) -> Made:
    """Learning curves from both stiffnesses, of both learners."""
    figure = Figure(figsize=(14, 10), layout="constrained")
    lines, n_rollouts = [], experiment.options.rollouts or SEARCH.n_rollouts
    for row, search in zip(figure.subplots(2, 2), SEARCHES, strict=True):
        for axes, start in zip(row, STARTS, strict=True):
            curves = history(experiment, search, start)
            n = 0 if curves is None else len(curves.cost[0])
            if curves is not None:
                draw_curves(axes, curves)
            axes.set_title(f"Digging from s⁰ = {start:g} N/m, learner {search}, {n} run(s)")
            if curves is None:
                continue
            first, last = ({name: median(v[i]) for name, v in curves.terms.items()} for i in (0, -1))
            terms = ", ".join(f"{name} {first[name]:.2f} → {last[name]:.2f}" for name in first if name != "control")
            lines.append(
                f"- {search}, {start:g} N/m, {n} run(s): {median(curves.cost[0]):.2f} → "
                f"{median(curves.cost[-1]):.2f} ({terms})."
            )
    _needed(experiment, bool(lines))
    return Made(
        figure,
        f"Cost of the policy without noise after each update of {n_rollouts} roll-outs, by terms: medians and quartiles over "
        "learning runs, one trial of each; trials of one policy differ by some tenths, since beds do. The gravel's term is "
        "3.5 N less the load.\n\n" + "\n".join(lines),
    )


def figure_17(experiment: Experiment) -> Made:
    """Total cost of uniform stiffness, and of what was learned."""
    recorded = experiment.recorded()
    uniform = [trials(recorded, f"uniform-{s:g}") for s in UNIFORM]
    _needed(experiment, all(uniform))
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots()
    mean = np.array([sample["total"].mean() for sample in uniform])
    std = np.array([deviation(sample["total"]) for sample in uniform])
    n = len(uniform[0]["total"])
    axes.plot(UNIFORM, mean, "o-", color=plotting.TERMS[0], label=f"uniform stiffness, mean of {n} trials")
    axes.fill_between(
        UNIFORM, mean - std, mean + std, color=plotting.TERMS[0], alpha=0.2, lw=0, label="one standard deviation"
    )
    best = best_uniform(recorded)
    lowest = means(recorded, best)["total"]
    rows = [_row(f"uniform, {s:g} N/m", sample) for s, sample in zip(UNIFORM, uniform, strict=True)]
    lines = []
    for i, (search, start) in enumerate((search, start) for search in SEARCHES for start in STARTS):
        sample = means(recorded, f"{search}-{start:g}")
        if not sample:
            continue
        values = sample["total"]
        rows.append(_row(f"learned from {start:g} N/m, {search}", sample))
        axes.errorbar(
            start,
            values.mean(),
            deviation(values) if len(values) > 1 else None,
            fmt=MARKERS[search],
            ms=11,
            mew=2.5,
            capsize=4,
            color=COLORS[search],
            label=f"learned, {search}: mean and deviation of runs" if i % len(STARTS) == 0 else "_nolegend_",
        )
        lines.append(
            f"- learned from {start:g} N/m, {search}: {len(values)} run(s), {summary(values)}, against {summary(lowest)} of "
            f"the best uniform stiffness ({best.removeprefix('uniform-')} N/m), Mann-Whitney p = {below(values, lowest):.1e}, "
            f"Cliff's δ = {delta(values, lowest):+.2f}"
        )
    axes.set(
        xlabel="(initial) uniform stiffness s⁰ [N/m]",
        ylabel="total cost of a trial",
        title="Digging: learned against uniform stiffness",
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    return Made(
        figure,
        "Total cost of policies learned from the same demonstrations with uniform stiffness, and after "
        f"{budget(experiment)} roll-outs of learning, at the stiffness that each started from. Every policy is tried {TRIALS} "
        "times on beds that no learning has met. Mean ± standard deviation, of uniform stiffness over trials, of what was "
        "learned over runs, each with the mean of its trials:\n\n"
        f"| policy | {' | '.join(COLUMNS)} |\n|{'---|' * (1 + len(COLUMNS))}\n"
        + "\n".join(rows)
        + "\n\nTotal costs of runs as median [quartiles], p one-sided:\n\n"
        + "\n".join(lines)
        + ("." if lines else "none yet."),
    )


def _row(name: str, sample: Sample) -> str:
    """A line of the table: mean ± standard deviation of each column, where there is more than one value."""
    cells = [name]
    for term, n in COLUMNS.values():
        values = sample[term]
        cells.append(f"{values.mean():.{n}f}" + (f" ± {deviation(values):.{n}f}" if len(values) > 1 else ""))
    return f"| {' | '.join(cells)} |"


def _needed(experiment: Experiment, there: bool) -> None:
    """Say what makes the experiment.

    Raises:
        InvalidArgumentError: it is not there.
    """
    if not there:
        raise InvalidArgumentError(
            f"figures 15 to 17 show the digging experiment, and too little of it stands in {experiment.folder}; "
            "`python -m train digging` makes it, as far as it is not there"
        )
