"""Figures 1 to 4: imitation, policy search, PI² against PI^BB, two starts (section 3)."""

from __future__ import annotations

from matplotlib.figure import Figure

import tasks
from train.learning.figures import draw_curves, draw_imitated, draw_learned
from train.paper.figures.base import Made, boxes
from train.paper.measured.base import learned
from train.paper.measured.via_points import SHAPES, asymmetry, letter
from train.statistics import below, summary


def figure_1(runs: int, seed: int) -> Made:
    """Two letters, learned from three demonstrations each."""
    figure = Figure(figsize=(12.5, 6), layout="constrained")
    for axes, shape in zip(figure.subplots(1, 2), SHAPES, strict=True):
        task = tasks.make("via_point", shape=shape)
        draw_imitated(axes, task, task.policy())
        axes.set_title(f"{shape}-shape")
    return Made(
        figure,
        "Three human demonstrations of each letter (orange), the mixture of four Gaussians fitted to them (ellipses, one "
        "standard deviation), the velocity field that follows by regression (streamlines), and the motion it generates from "
        "the start (red). The via-points, which the imitated motions miss, belong to the task of Fig. 2.",
    )


def figure_2(runs: int, seed: int) -> Made:
    """Final policies and learning curves of the via-point task."""
    figure = Figure(figsize=(13, 11), layout="constrained")
    lines = []
    for row, shape in zip(figure.subplots(2, 2), SHAPES, strict=True):
        learner = letter(shape, runs, seed)
        draw_learned(row[0], learner)
        draw_curves(row[1], learner.history)
        history = learner.history
        terms = ", ".join(f"{name.replace('_', '-')} {summary(v[-1])}" for name, v in history.terms.items())
        lines.append(f"- {shape}: total {history.cost[0][0]:.3g} → {summary(history.cost[-1])}; at the end {terms}.")
    return Made(
        figure,
        f"Policies after {learner.history.rollouts[-1]} roll-outs of PI^BB (left, {runs} runs; the field is that of the run "
        "with the median cost) and the cost of the noise-free policy by terms, median and quartiles (right). Measured, "
        "median [quartiles] over runs:\n\n" + "\n".join(lines) + "\n\nThe motions pass through the via-points, and the "
        "control cost only regularises. The acceleration term rises slowly but stays a small part of the cost: what remains "
        "at the end is unfinished optimisation rather than the trade-off that the paper describes.",
    )


def figure_3(runs: int, seed: int) -> Made:
    """Final costs of PI² and PI^BB."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    lines = []
    for axes, shape in zip(figure.subplots(1, 2), SHAPES, strict=True):
        final = {
            label: letter(shape, runs, seed, optimizer=name).history.cost[-1]
            for label, name in {"PI²": "pi2", "PI^BB": "pibb"}.items()
        }
        boxes(axes, final, "cost after 50 updates")
        axes.set_ylim(bottom=0)
        axes.set_title(f"{shape}-shape, {runs} runs")
        p = below(final["PI^BB"], final["PI²"])
        lines.append(
            f"- {shape}: PI² {summary(final['PI²'])}, PI^BB {summary(final['PI^BB'])}, Mann-Whitney p = {p:.1e}."
        )
    return Made(
        figure,
        "Cost of the noise-free policy after 50 updates of ten roll-outs, with the time average of PI² weighted by remaining "
        "time and activation. Median [quartiles]:\n\n" + "\n".join(lines),
    )


def figure_4(runs: int, seed: int) -> Made:
    """One policy for two starts."""
    figure = Figure(figsize=(13, 6), layout="constrained")
    left, right = figure.subplots(1, 2)
    learner = learned("two_starts", runs, seed)
    draw_learned(left, learner)
    draw_curves(right, learner.history)
    history = learner.history
    before, after = learner.task.rollout(learner.initial).x, learner.task.rollout(learner.policy).x
    return Made(
        figure,
        f"Two starts, two sets of via-points, one policy, after {history.rollouts[-1]} roll-outs of two trajectories each. The "
        "imitated motions (orange) are mirror images of each other, the learned ones are not. Total cost "
        f"{history.cost[0][0]:.3g} → {summary(history.cost[-1])} (median [quartiles] of {runs} runs); mean distance between "
        f"the right motion and the mirrored left one {float(asymmetry(before)):.3g} → "
        f"{summary(asymmetry(after).tolist())}.",
    )
