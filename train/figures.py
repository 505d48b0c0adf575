"""The pictures of a run: the field before and after, and the learning curves."""

from __future__ import annotations

import matplotlib

matplotlib.use("Agg")

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tasks import Task
from torchds import GMRPolicy, plotting
from train.records import History


def of_run(task: Task, initial: GMRPolicy, policy: GMRPolicy, history: History) -> dict[str, Figure]:
    """All figures of a finished run, by name.

    Args:
        task: what was learned.
        initial: the imitated policy.
        policy: the learned policies, batch_shape (runs,).
        history: costs of the runs.
    """
    return {"motion": motion(task, initial, policy, history), "learning_curves": curves(history)}


@torch.no_grad()
def motion(task: Task, initial: GMRPolicy, policy: GMRPolicy, history: History) -> Figure:
    """Figs 1 and 2: the imitated field, and the learned one of the run with the median cost."""
    figure = Figure(figsize=(12.5, 6), layout="constrained")
    before, after = figure.subplots(1, 2)
    first, last = task.rollout(initial), task.rollout(policy)
    order = torch.tensor(history.cost[-1]).argsort()
    typical = int(order[(len(order) - 1) // 2])
    draw_scene(before, task, initial, first.x, last.x)
    if task.source is not None:
        plotting.demonstrations(before, task.source)
    plotting.gaussians(before, initial)
    plotting.trajectories(before, first.x, color=plotting.AFTER, label="imitated motion")
    source = "a mixture" if task.source is None else f"{len(task.source)} demonstrations"
    plotting.finish_map(before, f"Learned from {source}", task.scene().unit)
    draw_scene(after, task, policy[typical], first.x, last.x)
    plotting.trajectories(after, first.x, color=plotting.DEMONSTRATION, label="imitated motion", lw=1.6)
    if len(order) > 1:
        plotting.trajectories(after, last.x, color=plotting.AFTER, label=f"all {len(order)} runs", lw=0.7, alpha=0.35)
    label = "learned motion" if len(order) == 1 else "learned motion (median run)"
    plotting.trajectories(after, last.x[typical], color=plotting.AFTER, label=label)
    plotting.finish_map(after, f"After {history.rollouts[-1]} roll-outs", task.scene().unit)
    return figure


def draw_scene(axes: Axes, task: Task, policy: GMRPolicy, *tracks: torch.Tensor) -> None:
    """Limits, field and markers of a task."""
    scene = task.scene()
    x, y = plotting.limits(*tracks, *(d.x[:, :2] for d in task.source or ()), *scene.via_points.values(), scene.starts)
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    plotting.field(axes, policy)
    plotting.markers(axes, scene.starts, scene.goal, scene.via_points)


def curves(history: History) -> Figure:
    """Learning curves by term (Fig. 2, right)."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.subplots()
    plotting.learning_curves(axes, history.rollouts, {"total": history.cost, **history.terms})
    n = len(history.cost[0])
    axes.set_title("Learning curve" if n == 1 else f"Learning curves: median and quartiles of {n} runs")
    return figure
