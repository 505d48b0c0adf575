"""The pictures of a run: the field before and after, and the learning curves."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tasks import Scene, Task
from torchds import GMRPolicy, Rollout, plotting
from torchds.dmp import DMP
from train.learning.history import History
from train.learning.learner import Learner


@contextmanager
def uncounted(task: Task) -> Iterator[None]:
    """What is tried in the block is not learned from: a task that counts its trials goes on as if there had been none."""
    state = copy.deepcopy(task.state_dict())
    try:
        yield
    finally:
        task.load_state_dict(state)


def of_run(learner: Learner) -> dict[str, Figure]:
    """All figures of a finished run, by name; the field is one of a plane, and not drawn in other dimensions."""
    if (D := learner.task.scene().starts.shape[-1]) != 2:
        print(
            f"motion.png is not drawn: the positions of {learner.task.name} have {D} dimensions, and fields are drawn in 2"
        )
        return {"learning_curves": curves(learner.history)}
    drawn = trial(learner) if learner.task.name == "lwr_digging" else motion(learner)
    return {"motion": drawn, "learning_curves": curves(learner.history)}


def motion(learner: Learner) -> Figure:
    """Figs 1 and 2: the imitated field, and the learned one."""
    figure = Figure(figsize=(12.5, 6), layout="constrained")
    before, after = figure.subplots(1, 2)
    draw_imitated(before, learner.task, learner.initial)
    draw_learned(after, learner)
    return figure


@torch.no_grad()
def progress(learner: Learner, path: Rollout) -> Figure:
    """The motions of all runs as they are now, on what was imitated; small, and without the field, since there are many."""
    task, history = learner.task, learner.history
    before, scene = task.rollout(learner.initial).x, task.scene()
    figure, axes = plotting.small_map(before, *scene.via_points.values(), *scene.obstacles())
    plotting.trajectories(axes, before, color=plotting.BEFORE, label="before learning", lw=1.4)
    runs = learner.options.runs
    label = "now" if runs == 1 else f"now, {runs} runs"
    plotting.trajectories(axes, path.x, color=plotting.AFTER, label=label, lw=1.4, alpha=1.0 if runs == 1 else 0.4)
    draw_obstacles(axes, scene)
    plotting.markers(axes, scene.starts, scene.goal, scene.via_points)
    plotting.finish_map(axes, f"After {history.rollouts[-1]} roll-outs", scene.unit)
    return figure


@torch.no_grad()
def trial(learner: Learner) -> Figure:
    """A digging trial of the learned policy: path, force and stiffness; the last one of the run."""
    if learner.path is None:
        learner.evaluate()
    path, task = learner.path, learner.task
    assert path is not None
    figure = Figure(figsize=(13, 8), layout="constrained")
    plane, force, stiffness = figure.subplot_mosaic([["plane", "force"], ["plane", "stiffness"]]).values()
    x, reference = (track.reshape(-1, *track.shape[-2:])[0] for track in (path.x, path.reference))
    draw_obstacles(plane, task.scene())
    grains = path.plant.snapshots.reshape(-1, *path.plant.snapshots.shape[-2:])[0, -1, 7:].reshape(-1, 3)
    plane.plot(*grains[:, :2].T, "o", color="#b5aea0", ms=4, label="gravel at the end")
    for i, demonstration in enumerate(task.source or ()):
        label = "demonstrations" if i == 0 else "_nolegend_"
        plotting.trajectories(plane, demonstration.x, color=plotting.DEMONSTRATION, label=label, lw=0.8)
    plotting.trajectories(plane, reference, color=plotting.BEFORE, label="reference", lw=1.6)
    plotting.trajectories(plane, x, color=plotting.AFTER, label="tool")
    for i in torch.linspace(0, len(x) - 1, 13).long().tolist():  # the blade
        along = 0.06 * torch.stack([x[i, 2].cos(), x[i, 2].sin()])
        ends = torch.stack([x[i, :2] - along, x[i, :2] + along])
        plane.plot(*ends.T, color="#4a4f57", lw=2.5, alpha=0.8, label="blade" if i == 0 else "_nolegend_")
    plotting.markers(plane, task.scene().starts, task.scene().goal, {})
    plotting.finish_map(plane, "One trial of the learned policy", "m")
    time = path.dt * torch.arange(1, len(x))
    magnitude = path.plant.force.reshape(-1, *path.plant.force.shape[-2:])[0].norm(dim=-1)
    force.plot(time, magnitude, color=plotting.TERMS[0], lw=1.0)
    force.set(
        xlabel="time [s]", ylabel="force on the shovel [N]", title="Force, without the weight of the empty shovel"
    )
    stiffness.plot(time, path.plant.stiffness.reshape(-1, len(time))[0], color=plotting.TERMS[1])
    stiffness.set(xlabel="time [s]", ylabel="stiffness [N/m]", title="Applied stiffness", ylim=(0, None))
    for axes in (force, stiffness):
        axes.grid(alpha=0.3)
    return figure


@torch.no_grad()
def draw_imitated(axes: Axes, task: Task, policy: GMRPolicy) -> None:
    """What was learned from demonstrations: field, Gaussians and motion (Fig. 1)."""
    path = task.rollout(policy)
    draw_scene(axes, task, policy, path.x)
    if task.source is not None:
        plotting.demonstrations(axes, task.source)
    if not isinstance(policy, DMP):
        plotting.gaussians(axes, policy)
    plotting.trajectories(axes, path.x, color=plotting.AFTER, label="imitated motion")
    source = "a mixture" if task.source is None else f"{len(task.source)} demonstrations"
    plotting.finish_map(axes, f"Learned from {source}", task.scene().unit)


@torch.no_grad()
def draw_learned(axes: Axes, learner: Learner) -> None:
    """What was learned by trial: the field of the run with the median cost, and the motions of all (Fig. 2)."""
    task, history = learner.task, learner.history
    first, last = task.rollout(learner.initial), task.rollout(learner.policy)
    order = torch.tensor(history.cost[-1]).argsort()
    typical = int(order[(len(order) - 1) // 2])
    draw_scene(axes, task, learner.policy[typical], first.x, last.x)
    plotting.trajectories(axes, first.x, color=plotting.DEMONSTRATION, label="imitated motion", lw=1.6)
    if len(order) > 1:
        plotting.trajectories(axes, last.x, color=plotting.AFTER, label=f"all {len(order)} runs", lw=0.7, alpha=0.35)
    label = "learned motion" if len(order) == 1 else "learned motion (median run)"
    plotting.trajectories(axes, last.x[typical], color=plotting.AFTER, label=label)
    plotting.finish_map(axes, f"After {history.rollouts[-1]} roll-outs", task.scene().unit)


def draw_scene(axes: Axes, task: Task, policy: GMRPolicy, *tracks: torch.Tensor) -> None:
    """Limits, field and markers of a task."""
    scene = task.scene()
    seen = [*tracks, *(d.x[:, :2] for d in task.source or ()), *scene.via_points.values(), scene.starts]
    x, y = plotting.limits(*seen, *scene.obstacles())
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    if not isinstance(policy, DMP):  # what drives it is a phase, and no place
        plotting.field(axes, policy)
    draw_obstacles(axes, scene)
    plotting.markers(axes, scene.starts, scene.goal, scene.via_points)


def draw_obstacles(axes: Axes, scene: Scene) -> None:
    """Walls and forbidden regions, where there are some."""
    if scene.walls is not None:
        plotting.walls(axes, scene.walls)
    if scene.regions is not None:
        plotting.discs(axes, *scene.regions)


def curves(history: History) -> Figure:
    """Learning curves by term (Fig. 2, right)."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    draw_curves(figure.subplots(), history)
    return figure


def draw_curves(axes: Axes, history: History) -> None:
    """All terms and their sum, median and quartiles over runs."""
    plotting.learning_curves(axes, history.rollouts, {"total": history.cost, **history.terms})
    n = len(history.cost[0])
    axes.set_title("Learning curve" if n == 1 else f"Learning curves: median and quartiles of {n} runs")
