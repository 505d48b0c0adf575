"""Agents of stable-baselines3 on the trials of a task: PPO and SAC, on top of the demonstrated policy."""

from __future__ import annotations

import importlib.util
import io
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tasks.base import Task
from tasks.gym import TaskVectorEnv, observations
from tasks.trials import Trials
from torchds.errors import MissingPackageError
from torchds.files import write_atomically

if importlib.util.find_spec("stable_baselines3") is None:
    raise MissingPackageError("stable-baselines3", "baselines", "deep reinforcement learning")

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

Array = np.ndarray[Any, Any]

HIDDEN = [32, 32]  # units; observations have 6 to 25 entries


class Batch(VecEnv):
    """A `TaskVectorEnv` as stable-baselines3 wants it."""

    def __init__(self, env: TaskVectorEnv) -> None:
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Array:
        """Take all environments to the start."""
        return self.env.reset()[0]

    def step_async(self, actions: Array) -> None:
        """Keep the actions of all environments until `step_wait` executes them."""
        self.actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        """Execute them: observations, rewards and ends of all environments; an ended one begins anew at once."""
        observations, rewards, ended, _, infos = self.env.step(self.actions)
        last = infos.get("final_obs", [None] * self.num_envs)
        each = [{} if x is None else {"terminal_observation": x, "TimeLimit.truncated": False} for x in last]
        return observations, rewards.astype(np.float32), ended, each

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the batch, which all environments share."""
        return [getattr(self.env, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the batch, which all environments share."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the batch once; all environments return the same."""
        return [getattr(self.env, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False] * self.num_envs


def ppo(env: VecNormalize, seed: int, n_steps: int) -> PPO:
    """PPO that updates after each batch of whole episodes.

    What differs from the defaults of stable-baselines3, and why: γ = 1 and λ = 0.99, since the costs of a motion come at its
    end; γ = 1 is what makes the return minus the cost; four minibatches of what are many and much alike steps, with a rate
    of 10⁻³ that falls to zero; a first standard deviation of e^−1.5 of the mean speed, since the demonstrated policy, the
    action zero, is nearly right; small nets.
    """
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda left: 1e-3 * left,
        n_steps=n_steps,
        batch_size=n_steps * env.num_envs // 4,
        gamma=1.0,
        gae_lambda=0.99,
        policy_kwargs={"net_arch": HIDDEN, "log_std_init": -1.5},
        seed=seed,
        device="cpu",
    )


def sac(env: VecNormalize, seed: int, n_steps: int) -> SAC:
    """SAC with one gradient step for each step of all environments, that is, for as many transitions as there are of them.

    What differs from the defaults of stable-baselines3, and why: γ = 1 as in `ppo`; learning starts after one batch of
    episodes; small nets.
    """
    return SAC(
        "MlpPolicy",
        env,
        gamma=1.0,
        learning_starts=n_steps * env.num_envs,
        policy_kwargs={"net_arch": HIDDEN},
        seed=seed,
        device="cpu",
    )


ALGORITHMS: dict[str, Callable[[VecNormalize, int, int], BaseAlgorithm]] = {"ppo": ppo, "sac": sac}


Report = Callable[[int, dict[str, Tensor] | None], None]
"""report(update, terms): the cost terms `()` of a trial after so many batches; None where none was made."""


class Evaluation(BaseCallback):
    """Tries the deterministic policy before learning, after every `every` batches of episodes, and at the end.

    Args:
        task: what is learned.
        n_updates: batches of episodes in all.
        every: batches between two trials.
        report: called after every batch, and once before.
    """

    def __init__(self, task: Task, n_updates: int, every: int, report: Report) -> None:
        super().__init__()
        self.trials, self.n_updates, self.every, self.report = Trials(task, 1), n_updates, every, report

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        update, within = divmod(self.num_timesteps, self.trials.n_steps * self.training_env.num_envs)
        if not within:  # SAC calls this at every step
            self.report(update, self.terms() if update % self.every == 0 else None)

    def _on_training_end(self) -> None:
        self.report(self.n_updates, self.terms())

    def terms(self) -> dict[str, Tensor]:
        """The cost terms of one trial."""
        trials, env = self.trials, self.training_env
        assert isinstance(env, VecNormalize)
        trials.reset()
        while not trials.done:
            seen = env.normalize_obs(observations(trials))
            trials.step(torch.as_tensor(self.model.predict(seen, deterministic=True)[0]))
        return {name: value[0] for name, value in trials.task.cost_terms(trials.path()).items()}


def learn(
    algorithm: str,
    task: Task,
    *,
    n_updates: int,
    n_rollouts: int,
    seed: int,
    every: int,
    report: Report,
) -> tuple[BaseAlgorithm, VecNormalize]:
    """Train one agent on `n_updates` batches of `n_rollouts` episodes; `report` and `every` as for `Evaluation`.

    Observations and rewards are normalised by their running statistics, as both algorithms expect it; these statistics
    belong to the agent and come back with it.
    """
    batch = TaskVectorEnv(task, n_rollouts)
    n_steps = batch.trials.n_steps
    normalized = VecNormalize(Batch(batch), gamma=1.0, clip_reward=np.inf)
    with own_randomness():
        agent = ALGORITHMS[algorithm](normalized, seed, n_steps)
        agent.learn(n_updates * n_rollouts * n_steps, callback=Evaluation(task, n_updates, every, report))
    return agent, normalized


def save(folder: Path, seed: int, agent: BaseAlgorithm, normalized: VecNormalize) -> None:
    """Write `agent-SEED.zip` and `normalization-SEED.pkl`, which stable-baselines3 loads, each whole or not at all.

    Raises:
        FileError: the disk is full, read-only or gone.
    """
    buffer = io.BytesIO()
    agent.save(buffer)
    write_atomically(folder / f"agent-{seed}.zip", lambda stream: stream.write(buffer.getbuffer()))
    write_atomically(folder / f"normalization-{seed}.pkl", lambda stream: pickle.dump(normalized, stream))


@contextmanager
def own_randomness() -> Iterator[None]:
    """stable-baselines3 seeds and draws from the global generators of torch and numpy: leave them as they were."""
    state = np.random.get_state()
    try:
        with torch.random.fork_rng(devices=()):
            yield
    finally:
        np.random.set_state(state)
