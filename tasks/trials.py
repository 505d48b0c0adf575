"""Roll-outs of a task one step at a time, for learners that act at every step."""

from __future__ import annotations

import torch
from torch import Tensor

from tasks.base import Task, rolls_out_itself, total
from torchds import Rollout
from torchds.errors import InvalidArgumentError
from torchds.moments import Moment, advance, begin, record, seen


class Trials:
    """M roll-outs of a task in one batch, as a Markov decision process of T steps; all of them begin and end together.

    An **action** of zero is the demonstrated policy at the present reference position. Its velocity part is added to the
    policy's velocity, in units of the mean speed of the demonstrated motion; its stiffness part changes the policy's
    stiffness, in units of that: s (1 + a). As in `torchds.rollout` the reference is what is moved, and the plant tracks
    it. A task with several starts has an action for each; executions of one motion under different conditions begin at
    the same place and share one action, since what they differ in is not to be known beforehand.

    The **observation** holds all that the rest of the cost depends on: each reference's position and last velocity (the
    acceleration costs), position and velocity of the plant, who has come to rest, how near each via-point has been
    passed so far (a minimum over the past), and the share of time left (the goal counts at the end alone). Lengths are
    in units of the distance from start to goal, speeds in units of the mean speed; what is not within ±`BOUND` is cut.

    The **reward** of a step is minus what falls due in it: running costs at their steps, via-points and goal at the end.
    The sum over an episode is minus `task.cost`. (Paying for via-points and goal as they come nearer has the same sum, but
    rewards a hundred times as large as what there is to learn: PPO did not learn from them.)

    Args:
        task: whose roll-outs are those of `torchds.rollout` with the task's plant and stop condition.
        n: M.

    Attributes:
        n_steps: T.
        n_actions: of the action vector of a roll-out.
        n_observations: of its observation vector.

    Raises:
        InvalidArgumentError: M < 1, a task that makes its roll-outs in a way of its own, or one whose plant is noisy.
    """

    BOUND = 10.0

    def __init__(self, task: Task, n: int) -> None:
        if n < 1:
            raise InvalidArgumentError(f"n has to be at least 1, got {n}")
        self.task, self.policy = task, task.policy().requires_grad_(False)
        if rolls_out_itself(task, self.policy):
            raise InvalidArgumentError(
                f"a task that is tried step by step has to use `Task.rollout`, got {task.name!r} with a rollout of its own"
            )
        if task.noisy and type(task).tried is not Task.tried:
            raise InvalidArgumentError(
                f"trials step by step are without chance, got {task.name!r} with some; leave out what makes it (sensor_noise, "
                "pushes)"
            )
        motion, scene = task.motion(), task.scene()
        x0, self.n_steps, self.dt = motion
        self.x0 = x0.expand(n, *x0.shape)
        self.via_points = torch.cat(list(scene.via_points.values()) or [x0.new_zeros(0, x0.shape[-1])])
        self.length = (scene.starts - scene.goal).norm(dim=-1).amax()
        self.speed = (task.rollout(self.policy).reference.diff(dim=-2).norm(dim=-1) / self.dt).mean()
        references, self.reference_of = x0.reshape(-1, x0.shape[-1]).unique(dim=0, return_inverse=True)
        self.action_shape = (n, len(references), self.policy.output_dim + self.policy.stiffness_dim)
        self.n_actions = self.action_shape[1] * self.action_shape[2]
        self.reset()
        self.n_observations = self.observe().shape[-1]

    def reset(self) -> None:
        """Put all roll-outs back to the start."""
        self.moments: list[Moment] = [begin(self.x0, self.policy.output_dim, self.task.stop, self.task.plant)]
        self.features: list[Tensor] = []
        self.stiffness: list[Tensor] = []
        self.inputs: list[Tensor] = []
        self.nearest = self.distances()
        self.cost = self.x0.new_zeros(len(self.x0))

    @property
    def now(self) -> Moment:
        """The state of the roll-outs at this moment."""
        return self.moments[-1]

    @property
    def t(self) -> int:
        """How many steps have been made."""
        return len(self.moments) - 1

    @property
    def done(self) -> bool:
        """Whether all steps are made."""
        return self.t == self.n_steps

    def path(self) -> Rollout:
        """The roll-outs so far, at least one step of them."""
        return record(self.moments, self.features, self.stiffness, self.dt, self.inputs)

    def step(self, actions: Tensor) -> Tensor:
        """One step under `actions` `(M, n_actions)`; returns the rewards `(M,)`.

        Raises:
            InvalidArgumentError: actions of another shape, or no steps left.
        """
        if actions.shape != (len(self.x0), self.n_actions):
            raise InvalidArgumentError(
                f"actions have to be {(len(self.x0), self.n_actions)}, got shape {tuple(actions.shape)}"
            )
        if self.done:
            raise InvalidArgumentError(f"all {self.n_steps} steps are made; call reset()")
        now, O = self.now, self.policy.output_dim
        a = actions.to(self.x0).view(self.action_shape)[:, self.reference_of].view(*now.x.shape[:-1], -1)
        t, task = self.t * self.dt, self.task
        x = seen(now, task.plant, t, self.dt) if task.feedback else now.x
        features = self.policy.features(x)
        y = self.policy.outputs(features, self.policy.rows())
        v, stiffness = y[..., :O] + self.speed * a[..., :O], None
        if self.policy.stiffness_dim:
            stiffness = y[..., O:] * (1 + a[..., O:])
            self.stiffness.append(stiffness)
        self.features.append(features)
        self.inputs.append(x)
        self.moments.append(advance(now, v, stiffness, t, self.dt, task.stop, task.plant, task.feedback))
        distances = self.distances()
        self.nearest = distances if self.t == 1 else torch.minimum(self.nearest, distances)  # the start does not count
        before, self.cost = self.cost, self.due()
        return before - self.cost

    def due(self) -> Tensor:
        """The cost so far `(M,)`: what adds up over time, and all of it at the end."""
        path = self.path()
        if self.done:
            return self.task.cost(path)
        running = self.task.running_costs(path)
        return total(steps.sum(-1) for steps in running.values()) if running else torch.zeros_like(self.cost)

    def distances(self) -> Tensor:
        """Distances `(M, *points, L)` from each via-point at this moment."""
        x = self.now.x if self.now.plant is None else self.now.plant.x
        return (x.unsqueeze(-2) - self.via_points).norm(dim=-1)

    def observe(self) -> Tensor:
        """The observations `(M, n_observations)`, finite whatever happened."""
        now, M = self.now, len(self.x0)
        parts = [now.x / self.length, now.v / self.speed, self.nearest / self.length]
        if now.plant is not None:
            parts += [now.plant.x / self.length, now.plant.v / self.speed]
        if now.resting is not None:
            parts.append(now.resting.unsqueeze(-1).to(now.x))
        left = now.x.new_full((M, 1), 1 - self.t / self.n_steps)
        flat = torch.cat([*(part.reshape(M, -1) for part in parts), left], -1)
        return flat.nan_to_num(self.BOUND).clamp(-self.BOUND, self.BOUND)
