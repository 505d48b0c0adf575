"""Figures 15 to 17: the digging experiment (section 6)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from torchds import plotting
from train.learning.figures import draw_curves
from train.paper.figures.base import Made
from train.paper.measured.digging import SEARCHES, STARTS, TRIALS, UNIFORM, Experiment, best_uniform
from train.statistics import below

COLORS = dict(zip(SEARCHES, (plotting.AFTER, plotting.GAUSSIAN), strict=True))
MARKERS = dict(zip(SEARCHES, ("x", "P"), strict=True))


def figure_15(experiment: Experiment) -> Made:
    """The scene, at three times of a learned motion."""
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
    lines = []
    for row, search in zip(figure.subplots(2, 2), SEARCHES, strict=True):
        for axes, start in zip(row, STARTS, strict=True):
            history = experiment.learned(search, start).history
            draw_curves(axes, history)
            axes.set_title(f"Digging from s⁰ = {start:g} N/m, learner {search}")
            first, last = ({name: v[i][0] for name, v in history.terms.items()} for i in (0, -1))
            terms = ", ".join(f"{name} {first[name]:.2f} → {last[name]:.2f}" for name in first if name != "control")
            lines.append(f"- {search}, {start:g} N/m: {history.cost[0][0]:.2f} → {history.cost[-1][0]:.2f} ({terms}).")
    return Made(
        figure,
        "Cost of the policy without noise after each update of eight roll-outs, one trial each, by terms; trials of one policy "
        "differ by some tenths, since one grain weighs 0.3 N. The gravel's term is 3.5 N less the load.\n\n"
        + "\n".join(lines),
    )


def figure_17(experiment: Experiment) -> Made:
    """Total cost of uniform stiffness, and of what was learned."""
    trials = experiment.trials()
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots()
    costs = np.array([trials[f"uniform-{s:g}"]["total"] for s in UNIFORM])
    mean, std = costs.mean(1), costs.std(1, ddof=1)
    axes.plot(UNIFORM, mean, "o-", color="#1f5fa8", label=f"uniform stiffness, mean of {TRIALS} trials")
    axes.fill_between(UNIFORM, mean - std, mean + std, color="#1f5fa8", alpha=0.2, lw=0, label="one standard deviation")
    best = best_uniform(trials)
    lowest = trials[best]["total"]
    lines = [
        f"- best uniform stiffness, {best.removeprefix('uniform-')} N/m: {np.mean(lowest):.2f} ± {np.std(lowest, ddof=1):.2f}"
    ]
    for search in SEARCHES:
        for i, start in enumerate(STARTS):
            values = trials[f"{search}-{start:g}"]["total"]
            axes.errorbar(
                start,
                np.mean(values),
                np.std(values, ddof=1),
                fmt=MARKERS[search],
                ms=11,
                mew=2.5,
                capsize=4,
                color=COLORS[search],
                label=f"learned, {search}" if i == 0 else "_nolegend_",
            )
            lines.append(
                f"- learned from {start:g} N/m, {search}: {np.mean(values):.2f} ± {np.std(values, ddof=1):.2f}, "
                f"{'below' if np.mean(values) < mean.min() else 'not below'} every uniform stiffness in the mean; against the "
                f"best of them Mann-Whitney p = {below(values, lowest):.1e}"
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
        f"Total cost of policies learned from the same demonstrations with uniform stiffness, over {TRIALS} trials on beds "
        f"that no learning has met, and after 80 roll-outs of learning, at the stiffness that each started from (mean ± "
        "standard deviation; p is one-sided):\n\n" + "\n".join(lines) + ".",
    )
