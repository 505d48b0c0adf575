"""Digging as a Gymnasium environment, an episode a trial on a bed of its own: `gymnasium.make("torchds/LwrDigging-v0")`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor

import tasks
from tasks.digging import lwr
from tasks.digging.rendering import render
from tasks.digging.simulation import Recording, Trials
from tasks.digging.task import LwrDigging
from tasks.lwr_digging import HIGH, LOW
from tasks.trials import Trials as Walk

PERIOD = 0.1  # s between two actions
FAILED = 100.0  # what a trial costs that fails
FORCE, STIFFNESS = 10.0, 150.0  # N, N/m, units of observations

Array = np.ndarray[Any, Any]


class LwrDiggingEnv(gymnasium.Env[Array, Array]):
    """The digging task, ten actions a second.

    An **action** of zero is the demonstrated policy; the first three numbers change the velocity of the reference, in units of
    the mean speed of the demonstrated motion (x, z) and of its turn, the last one the stiffness, s (1 + a). The
    **observation** holds pose and velocity of the reference, pose of the tool and the force on it, the stiffness, and the
    share of time left. The **reward** is minus what falls due, the gravel and the goal at the end; an episode adds up to
    minus the cost of the trial. One that fails ends at once, with −100.

    The bed is drawn with the seed of `reset`.

    Args:
        render_mode: "rgb_array" for pictures.
        **options: of the task `lwr_digging`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012, as Gymnasium has it

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        task = tasks.make("lwr_digging", **{"threads": 1, **options})
        assert isinstance(task, LwrDigging)
        self.task, self.render_mode = task, render_mode
        self.policy = task.policy().requires_grad_(False)
        self._path, reference, _ = task.reference(self.policy)
        change = reference.diff(dim=0).abs().mean(0) / task.dt
        plane = torch.linalg.vector_norm(reference[:, :2].diff(dim=0), dim=-1).mean() / task.dt
        self.unit = torch.stack([plane, plane, change[2]])  # of the velocity
        self.n_steps, self.between = len(reference) - 1, max(1, round(PERIOD / task.dt))
        self.observation_space = Box(-Walk.BOUND, Walk.BOUND, (14,))
        self.action_space = Box(-1.0, 1.0, (4,))

    # ------------------------------------------------------------------ an episode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin a trial on a bed."""
        super().reset(seed=seed)
        bed = int(self.np_random.integers(2**31))
        self.reference, self.velocity = self.task.start.clone(), torch.zeros(3, dtype=torch.float64)
        self.trials = Trials(self.task.worlds(1), self.reference[None], [bed])
        self.cost = 0.0
        return self._observation(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """A tenth of a second."""
        a = torch.as_tensor(np.asarray(action), dtype=torch.float64)
        within = True
        with torch.no_grad():
            for _ in range(min(self.between, self.n_steps - len(self.trials.torques))):
                x = self.reference[:2]
                self.velocity = self.policy(x) + self.unit * a[:3]
                s = (self.policy.stiffness(x)[0] * (1 + a[3])).clamp(LOW, HIGH)
                ahead = self.reference + self.task.dt * self.velocity
                within = bool(lwr.reaches(*ahead))
                if not within:
                    break
                self.reference = ahead
                self.trials.step(ahead[None], self.velocity[None], s[None])
        done = len(self.trials.torques) == self.n_steps
        before, self.cost = self.cost, FAILED
        if within and not (recording := self.recording()).failed.any():
            self.cost = self._due(recording, done)
        else:
            done = True
        return self._observation(), before - self.cost, done, False, {}

    def recording(self) -> Recording:
        """What was measured so far, after a step at least."""
        return self.trials.recording()

    def render(self) -> Any:
        """The scene now, `(480, 640, 3)`, where pictures were asked for."""
        if self.render_mode != "rgb_array":
            return None
        return render(self.task.gravel, self.task.worlds(1).snapshot())[0]

    # ------------------------------------------------------------------ what it tells

    def _due(self, done: Recording, ended: bool) -> float:
        """The cost so far: what adds up over time, and all of it at the end."""
        path = replace(self._path, x=done.pose, v=done.pose.diff(dim=-2) / self.task.dt, plant=done)
        terms = self.task.cost_terms(path) if ended else self.task.running_costs(path)
        return float(torch.stack([term.sum() for term in terms.values()]).sum())

    def _observation(self) -> Array:
        trials = self.trials
        made = len(trials.torques)
        force = torch.zeros(3, dtype=torch.float64)
        if made:
            frame, sensed = trials.readings[-1]
            force = trials.worlds.force(frame, sensed)[0]
        stiffness = trials.stiffness[-1] if made else self.policy.stiffness(self.reference[:2])
        parts: list[Tensor] = [self.reference, self.velocity / self.unit, trials.poses[-1][0], force / FORCE]
        left = torch.tensor([1 - made / self.n_steps], dtype=torch.float64)
        seen = torch.cat([*parts, stiffness.reshape(1) / STIFFNESS, left])
        return seen.nan_to_num().clamp(-Walk.BOUND, Walk.BOUND).numpy().astype(np.float32)
