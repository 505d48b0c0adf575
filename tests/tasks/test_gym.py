import runpy
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common import env_checker

import tasks.gym
from tasks import ENVIRONMENTS
from torchds.errors import MissingPackageError

EVERY = pytest.mark.parametrize("name", ENVIRONMENTS)


@pytest.fixture(scope="module")
def env_of():
    """The environment of each name, made once."""
    made = {}

    def get(name):
        if name not in made:
            made[name] = gymnasium.make(f"torchds/{name}-v0").unwrapped
        return made[name]

    return get


@pytest.fixture(scope="module")
def actions_of(env_of):
    """M sequences of random actions `(T, M, n_actions)`."""

    def get(name, M=3, size=0.5):
        trials = env_of(name).trials
        noise = np.random.default_rng(5).uniform(-size, size, (trials.n_steps, M, trials.n_actions))
        return noise.astype(np.float32)

    return get


def play(env, actions):
    """Observations, the one after the last step too, rewards and flags of an episode."""
    observations, rewards, flags = [env.reset(seed=1)[0]], [], []
    for action in actions:
        observation, reward, terminated, truncated, infos = env.step(action)
        observations.append(infos.get("final_obs", observation))
        rewards.append(reward)
        flags.append((terminated, truncated))
    return np.array(observations), np.array(rewards), flags


class Scripted:
    """A policy to which something is added at every step, whatever the state."""

    def __init__(self, policy, change):
        self.policy, self.change = policy, iter(change)
        self.batch_shape = (3,)

    def __getattr__(self, name):
        return getattr(self.policy, name)

    def outputs(self, features, rows):
        return next(self.change)(self.policy.outputs(features, rows))


@EVERY
@pytest.mark.slow
def test_both_libraries_find_nothing_wrong(name, env_of):
    check_env(env_of(name))
    env_checker.check_env(env_of(name))


@EVERY
@pytest.mark.slow
def test_rewards_add_up_to_minus_the_cost_of_the_plain_rollout(name, env_of, actions_of):
    task, actions = env_of(name).trials.task, actions_of(name)
    policy = task.policy()
    O, starts = policy.output_dim, {"TwoStarts": 2}.get(name, 1)
    speed = task.rollout(policy).reference.diff(dim=-2).norm(dim=-1).mean() / task.motion().dt
    corrections = torch.from_numpy(actions).double().unflatten(-1, (starts, -1))  # (T, M, starts, O+Q)
    if starts == 1 and task.motion().x0.ndim == 1:
        corrections = corrections.squeeze(-2)  # one trajectory; the two of HalfPlaneForce share theirs

    def changed(a):
        return lambda y: torch.cat([y[..., :O] + speed * a[..., :O], y[..., O:] * (1 + a[..., O:])], -1)

    with torch.no_grad():
        cost = task.cost(task.rollout(Scripted(policy, map(changed, corrections))))
    _, rewards, _ = play(tasks.gym.TaskVectorEnv(task, 3), actions)
    np.testing.assert_allclose(-rewards.sum(0), cost.numpy(), rtol=1e-11)
    assert len(set(cost.tolist())) == 3


@EVERY
@pytest.mark.slow
def test_the_batch_is_as_many_single_environments(name, env_of, actions_of):
    actions = actions_of(name)
    env = tasks.gym.TaskVectorEnv(env_of(name).trials.task, 3)
    observations, rewards, flags = play(env, actions)
    for i in range(3):
        alone, rewards_alone, flags_alone = play(env_of(name), actions[:, i])
        np.testing.assert_allclose(observations[:, i], alone, rtol=1e-5, atol=1e-6)  # float32
        np.testing.assert_allclose(rewards[:, i], rewards_alone, rtol=1e-9, atol=1e-12)
        assert [(bool(a[i]), bool(b[i])) for a, b in flags] == flags_alone
    assert [a.all() for a, _ in flags] == [False] * (len(actions) - 1) + [True]
    assert not any(b.any() for _, b in flags)


@EVERY
@pytest.mark.slow
def test_zero_actions_are_the_demonstrated_policy(name, env_of):
    task = env_of(name).trials.task
    _, rewards, _ = play(env_of(name), np.zeros((env_of(name).trials.n_steps, env_of(name).trials.n_actions)))
    with torch.no_grad():
        cost = float(task.cost(task.rollout(task.policy())))
    assert -rewards.sum() == pytest.approx(cost, rel=1e-11)


@pytest.mark.slow
def test_costs_fall_due_when_they_arise(env_of):
    """Stiffness costs at every step, via-points and goal nothing before the last."""
    trials = env_of("DivergentField").trials
    _, rewards, _ = play(env_of("DivergentField"), np.zeros((trials.n_steps, trials.n_actions)))
    terms = trials.task.cost_terms(trials.path())
    running = float(terms["acceleration"] + terms["stiffness"])
    assert rewards.max() < 0  # the constant initial stiffness
    assert rewards[:-1].sum() == pytest.approx(-running, rel=0.02)
    assert rewards[-1] < -float(terms["via_points"] + terms["goal"])


@pytest.mark.slow
def test_the_batch_begins_again_in_the_step_in_which_it_ends(env_of, actions_of):
    env = tasks.gym.TaskVectorEnv(env_of("ViaPointN").trials.task, 3)
    start, _ = env.reset()
    for action in actions_of("ViaPointN"):
        observations, *_, infos = env.step(action)
    np.testing.assert_array_equal(observations, start)
    assert infos["_final_obs"].all() and not np.allclose(infos["final_obs"], start)


def test_two_starts_have_an_action_each_and_two_executions_share_theirs(env_of):
    assert env_of("TwoStarts").trials.action_shape == (1, 2, 2)
    assert env_of("HalfPlaneForce").trials.action_shape == (1, 1, 4)


@pytest.mark.slow
def test_the_ids_make_the_batch_too(env_of):
    env = gymnasium.make_vec("torchds/ViaPointP-v0", num_envs=2, vectorization_mode="vector_entry_point")
    assert isinstance(env.unwrapped, tasks.gym.TaskVectorEnv)
    assert env.observation_space.shape == (2, *env_of("ViaPointP").observation_space.shape)


def test_without_gymnasium_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"'gymnasium'.*torchds\[baselines\]"):
        runpy.run_path(str(Path(tasks.gym.__file__)))


@EVERY
@pytest.mark.slow
def test_pictures_show_the_motion_so_far(name, env_of, actions_of):
    env = tasks.gym.TaskEnv(env_of(name).trials.task, render_mode="rgb_array")
    env.reset()
    first = env.render()
    for action in actions_of(name)[:8, 0]:
        env.step(action)
    later = env.render()
    assert first.shape == later.shape == (480, 480, 3) and first.dtype == np.uint8
    assert (first != later).any(-1).sum() > 20
    assert env_of(name).render() is None
