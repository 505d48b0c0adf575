"""Figures 9 to 14: motion and stiffness learned together in two force fields (section 5.4)."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

import tasks
from tasks import DivergentField
from torchds import GMRPolicy, Rollout, plotting
from train.learning.figures import draw_curves
from train.learning.learner import Learner
from train.paper.figures.base import Made, boxes
from train.paper.measured.base import via_distances
from train.paper.measured.impedance import (
    before_learning,
    divergent,
    final,
    half_plane,
    off_nominal,
    pushed,
    stiffness_by_half,
    via_points,
)
from train.statistics import below, summary

AXES = ("1", "2")


@torch.no_grad()
def figure_9(runs: int, seed: int) -> Made:
    """The initial motion in the divergent field."""
    task, path = before_learning("divergent_field")
    assert isinstance(task, DivergentField)
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots()
    frame(axes, task, path.x, path.reference)
    xs, ys = (np.linspace(*lim, 22) for lim in (axes.get_xlim(), axes.get_ylim()))
    grid = torch.from_numpy(np.stack(np.meshgrid(xs, ys), -1))
    f = task.force()(0.0, grid, torch.zeros_like(grid))
    axes.quiver(xs, ys, f[..., 0], f[..., 1], color="#b9b9b9", width=0.0022, label="force field")
    axes.plot(*task.nominal().T, "--", color="#4a4a4a", lw=1.3, label="nominal path (no force)")
    draw_motion(axes, path)
    plotting.finish_map(axes, "Divergent field: before learning", task.scene().unit)
    return Made(
        figure,
        "The imitated reference (red) lies beside the nominal path, where the force (grey arrows, 10 N/m times the distance) "
        f"is zero; the point mass (blue), held with the constant stiffness {task.initial_stiffness:g} N/m, is pushed up to "
        f"{float(off_nominal(task, path.x).max()):.2f} m away from that path.",
    )


@torch.no_grad()
def figure_10(runs: int, seed: int) -> Made:
    """Final motions and stiffness in the divergent field."""
    learner = divergent(runs, seed)
    path, history = final(learner), learner.history
    figure = stiffness_figure(learner, path.x, f"Actual motions of {runs} runs after {history.rollouts[-1]} roll-outs")
    before = learner.task.rollout(learner.initial).x
    points = via_points(learner.task)
    distance = {name: via_distances(x, points) for name, x in {"before": before, "after": path.x}.items()}
    mean = path.plant.stiffness[..., 1:, :].mean((0, 1))
    return Made(
        figure,
        "Above left, the actual motions of all runs; right, the applied stiffness along them, mean and standard deviation "
        f"over runs. Below, the stiffness over the state space, mean over runs. Measured: mean stiffness {mean[0]:.1f} and "
        f"{mean[1]:.1f} N/m (from 20); mean distance to the via-points {float(distance['before'].mean()):.2f} → "
        f"{float(distance['after'].mean()):.2f} m; the total cost fell in "
        f"{sum(a < b for a, b in zip(history.cost[-1], history.cost[0], strict=True))} of {runs} runs.",
    )


def figure_11(runs: int, seed: int) -> Made:
    """Learning curve in the divergent field, and what learning one of the two alone gives."""
    learner = divergent(runs, seed)
    figure = Figure(figsize=(13, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_curves(left, learner.history)
    alone = {name: divergent(runs, seed, learn=name).history for name in ("motion", "stiffness")}
    samples = {"both": learner.history.cost[-1]} | {f"{name} only": h.cost[-1] for name, h in alone.items()}
    boxes(right, samples, f"cost after {learner.history.rollouts[-1]} roll-outs")
    right.set_title("What is learned")
    terms = learner.history.terms
    falls = {n: 100 * (1 - np.median(terms[n][-1]) / np.median(terms[n][0])) for n in ("via_points", "stiffness")}
    lines = [
        f"- against {name} alone ({summary(samples[f'{name} only'])}): Mann-Whitney p = "
        f"{below(samples['both'], samples[f'{name} only']):.1e}"
        for name in alone
    ]
    return Made(
        figure,
        f"The via-point cost falls by {falls['via_points']:.0f} % and the stiffness cost by {falls['stiffness']:.0f} % "
        f"(medians of {runs} runs); total {learner.history.cost[0][0]:.3g} → {summary(samples['both'])}. Learning motion and "
        "stiffness together is better than learning either alone:\n\n" + "\n".join(lines),
    )


@torch.no_grad()
def figure_12(runs: int, seed: int) -> Made:
    """The initial motions without and with the half-plane force."""
    task, path = before_learning("half_plane_force")
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots()
    frame(axes, task, path.x, path.reference)
    draw_executions(axes, path)
    plotting.finish_map(axes, "Half-plane force: before learning", task.scene().unit)
    return Made(
        figure,
        "Without the force the point mass tracks its reference, through or near the via-points; with the force (shaded half, "
        f"10 N upwards) it is moved by up to {float(pushed(path)):.2f} m, so that the last two via-points are missed.",
    )


def figure_13(runs: int, seed: int) -> Made:
    """A typical result with the half-plane force."""
    learner = half_plane(runs, seed, "diagonal")
    path = final(learner)
    order = np.argsort(learner.history.cost[-1])
    typical = int(order[(len(order) - 1) // 2])
    figure = stiffness_figure(learner, path.x[typical], "Median run: with and without the force", executions=True)
    inside, outside = (half.mean(0) for half in stiffness_by_half(path))
    return Made(
        figure,
        "Above left, the motions of the median run with and without the force; right, the applied stiffness along the "
        "disturbed ones, mean and standard deviation over runs. Below, the stiffness over the state space, mean over runs. "
        f"Measured, mean over runs: where the force can be, s1 = {inside[0]:.1f} and s2 = {inside[1]:.1f} N/m; elsewhere "
        f"{outside[0]:.1f} and {outside[1]:.1f}; before learning 10 everywhere.",
    )


def figure_14(runs: int, seed: int) -> Made:
    """Learning curve with the half-plane force, and diagonal against isotropic stiffness."""
    figure = Figure(figsize=(13, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    learners = {kind: half_plane(runs, seed, kind) for kind in ("isotropic", "diagonal")}
    history = learners["diagonal"].history
    draw_curves(left, history)
    samples = {kind: learner.history.cost[-1] for kind, learner in learners.items()}
    boxes(right, samples, f"cost after {history.rollouts[-1]} roll-outs")
    right.set_title("Stiffness")
    cost = np.mean(history.terms["stiffness"], axis=1)
    peak = int(cost.argmax())
    return Made(
        figure,
        f"Left: the via-point cost falls at once while the stiffness cost first rises, from {cost[0]:.3f} to {cost[peak]:.3f} "
        f"at {history.rollouts[peak]} roll-outs, and then falls to {cost[-1]:.3f} (means of {runs} runs). Right: final cost, "
        f"diagonal {summary(samples['diagonal'])} against isotropic {summary(samples['isotropic'])}, Mann-Whitney "
        f"p = {below(samples['diagonal'], samples['isotropic']):.1e}.",
    )


# ------------------------------------------------------------------ pieces


def frame(axes: Axes, task: tasks.Task, *tracks: Tensor) -> None:
    """Limits and markers."""
    scene = task.scene()
    xlim, ylim = plotting.limits(*tracks, *scene.via_points.values(), scene.starts)
    axes.set_xlim(*xlim)
    axes.set_ylim(*ylim)
    plotting.markers(axes, scene.starts, scene.goal, scene.via_points)


def draw_motion(axes: Axes, path: Rollout) -> None:
    """Reference and actual motion."""
    plotting.trajectories(axes, path.reference, color=plotting.AFTER, label="reference")
    plotting.trajectories(axes, path.x, color=plotting.TERMS[0], label="actual motion")


def draw_executions(axes: Axes, path: Rollout) -> None:
    """Reference and both executions, and where the force is."""
    axes.axvspan(-5, axes.get_xlim()[1], color="#f0ead8", zorder=0, label="force, if present")
    plotting.trajectories(axes, path.reference[..., 0, :, :], color=plotting.AFTER, label="reference")
    for i, (label, color) in enumerate((("without force", plotting.TERMS[1]), ("with force", plotting.TERMS[0]))):
        plotting.trajectories(axes, path.x[..., i, :, :], color=color, label=label, lw=1.8)


@torch.no_grad()
def stiffness_figure(learner: Learner, motions: Tensor, title: str, *, executions: bool = False) -> Figure:
    """Motions, stiffness along them, and maps of the stiffness: the layout of Figs 10 and 13."""
    task, path = learner.task, final(learner)
    figure = Figure(figsize=(14, 11), layout="constrained")
    (motion, along), maps = figure.subplots(2, 2)
    frame(motion, task, motions)
    if executions:
        motion.axvspan(-5, motion.get_xlim()[1], color="#f0ead8", zorder=0, label="force, if present")
        for i, (label, color) in enumerate((("without force", plotting.TERMS[1]), ("with force", plotting.TERMS[0]))):
            plotting.trajectories(motion, motions[i], color=color, label=label)
    else:
        plotting.trajectories(motion, motions, color=plotting.TERMS[0], label="actual motions", lw=1.0, alpha=0.6)
    plotting.finish_map(motion, title, task.scene().unit)
    s = path.plant.stiffness[..., 1:, :]
    s = s[:, -1] if s.ndim == 4 else s  # (runs, T, D), of the disturbed execution
    t = path.dt * np.arange(1, s.shape[-2] + 1)
    for d, color in zip(range(2), (plotting.AFTER, plotting.TERMS[0]), strict=True):
        mean, deviation = s[..., d].mean(0), s[..., d].std(0)
        along.plot(t, mean, color=color, label=f"s{AXES[d]}, mean of {len(s)} runs")
        along.fill_between(t, mean - deviation, mean + deviation, color=color, alpha=0.18, lw=0, label="± 1 sd")
    along.axhline(task.initial_stiffness, color="black", ls=":", label="before learning")  # type: ignore[attr-defined]
    along.set_xlabel("time [s]")
    along.set_ylabel("applied stiffness [N/m]")
    along.set_title("Stiffness along the motion")
    along.grid(alpha=0.3)
    along.legend(fontsize=8)
    for d, axes in enumerate(maps):
        draw_stiffness_map(figure, axes, learner.policy, task, d, motions)
    return figure


def draw_stiffness_map(figure: Figure, axes: Axes, policy: GMRPolicy, task: tasks.Task, d: int, tracks: Tensor) -> None:
    """Stiffness of one axis over the state space, mean over the batch, cut at zero."""
    frame(axes, task, tracks)
    xs, ys = (np.linspace(*lim, 80) for lim in (axes.get_xlim(), axes.get_ylim()))
    grid = torch.from_numpy(np.stack(np.meshgrid(xs, ys), -1))
    values = policy.stiffness(grid.expand(*policy.batch_shape, *grid.shape))[..., min(d, policy.stiffness_dim - 1)]
    mean = values.clamp_min(0.0).mean(0)
    image = axes.pcolormesh(xs, ys, mean.numpy(), cmap="viridis", shading="gouraud")
    figure.colorbar(image, ax=axes, shrink=0.8, label=f"s{AXES[d]} [N/m]")
    plotting.gaussians(axes, policy)
    plotting.finish_map(axes, f"State-dependent stiffness, axis {AXES[d]}", task.scene().unit)
