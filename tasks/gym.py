"""The tasks as Gymnasium environments, an episode a roll-out: `gymnasium.make("torchds/ViaPointN-v0")` after importing this."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import torch

import tasks
from tasks import ENVIRONMENTS
from tasks.base import Task
from tasks.trials import Trials
from torchds.errors import MissingPackageError

if importlib.util.find_spec("gymnasium") is None:
    raise MissingPackageError("gymnasium", "baselines", "a task as an environment")

import gymnasium
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

Array = np.ndarray[Any, Any]


def _trials(task: Task | str, n: int, options: dict[str, Any]) -> Trials:
    return Trials(tasks.make(task, **options) if isinstance(task, str) else task, n)


def _spaces(trials: Trials) -> tuple[Box, Box]:
    """The spaces of observations and of actions."""
    return Box(-Trials.BOUND, Trials.BOUND, (trials.n_observations,)), Box(-1.0, 1.0, (trials.n_actions,))


def observations(trials: Trials) -> Array:
    """`Trials.observe` in float32."""
    return trials.observe().numpy().astype(np.float32)


def drawn(trials: Trials) -> Array:
    """A picture `(480, 480, 3)` in bytes of the first roll-out so far, the plant and its reference."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from torchds import plotting

    task, scene = trials.task, trials.task.scene()
    figure = Figure(figsize=(4.8, 4.8), dpi=100, layout="constrained")
    axes = figure.subplots()
    plotting.demonstrations(axes, task.demonstrations)
    if scene.walls is not None:
        plotting.walls(axes, scene.walls)
    if scene.regions is not None:
        plotting.discs(axes, *scene.regions)
    if trials.t:
        path = trials.path()
        plotting.trajectories(axes, path.reference[0], color="0.5", label="reference", lw=1.2)
        plotting.trajectories(axes, path.x[0], color=plotting.AFTER, label="motion")
    plotting.markers(axes, scene.starts, scene.goal, scene.via_points)
    plotting.finish_map(axes, f"t = {trials.t * trials.dt:.1f} s", scene.unit)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


class TaskEnv(gymnasium.Env[Array, Array]):
    """A task as an environment; `Trials` explains actions, observations and rewards.

    Observations and actions are float32, the roll-out between them is float64. Nothing is random: equal actions give equal
    episodes, whatever the seed. An episode is terminated, not truncated, after T steps: nothing comes after it.

    Args:
        task: the task, or its name for `tasks.make`.
        render_mode: "rgb_array" for pictures of the motion so far.
        **options: of the task, with its name.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012, as Gymnasium has it

    def __init__(self, task: Task | str, render_mode: str | None = None, **options: Any) -> None:
        self.trials, self.render_mode = _trials(task, 1, options), render_mode
        self.observation_space, self.action_space = _spaces(self.trials)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Go back to the start."""
        super().reset(seed=seed)
        self.trials.reset()
        return observations(self.trials)[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Make one step of the roll-out."""
        reward = self.trials.step(torch.as_tensor(action)[None])
        return observations(self.trials)[0], float(reward), self.trials.done, False, {}

    def render(self) -> Any:
        """Scene, demonstrations and the motion so far, `(480, 480, 3)`, where pictures were asked for."""
        return drawn(self.trials) if self.render_mode == "rgb_array" else None


class TaskVectorEnv(gymnasium.vector.VectorEnv[Array, Array, Array]):
    """M environments of a task in one batch: one tensor call a step, however many there are.

    All of them end in the same step, and begin again in it (`AutoresetMode.SAME_STEP`): the observation that comes back is
    the start's, the last one is in `infos["final_obs"]`.

    Args:
        task: as for `TaskEnv`.
        num_envs: M.
        **options: as for `TaskEnv`.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012, as Gymnasium has it

    def __init__(self, task: Task | str, num_envs: int = 1, **options: Any) -> None:
        self.num_envs, self.trials = num_envs, _trials(task, num_envs, options)
        self.single_observation_space, self.single_action_space = _spaces(self.trials)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Put all roll-outs back to the start."""
        super().reset(seed=seed)
        self.trials.reset()
        return observations(self.trials), {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Make one step of every roll-out."""
        rewards, done = self.trials.step(torch.as_tensor(actions)).numpy(), self.trials.done
        ended, infos = np.full(self.num_envs, done), {}
        if done:
            infos = {"final_obs": observations(self.trials), "_final_obs": ended.copy()}
            self.trials.reset()
        return observations(self.trials), rewards, ended, np.zeros_like(ended), infos


gymnasium.register("torchds/LwrDigging-v0", "tasks.digging.gym:LwrDiggingEnv")
for _name, (_task, _options) in ENVIRONMENTS.items():
    gymnasium.register(
        f"torchds/{_name}-v0",
        "tasks.gym:TaskEnv",
        vector_entry_point="tasks.gym:TaskVectorEnv",
        kwargs={"task": _task, **_options},
    )
