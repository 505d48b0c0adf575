"""Digging step by step: what both libraries ask for, zero actions as the task's own trial, and failures."""

import numpy as np
import pytest
import torch

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")
pytest.importorskip("stable_baselines3")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from stable_baselines3.common import env_checker  # noqa: E402

import tasks.gym  # noqa: E402
from tasks.digging import gym  # noqa: E402

SHORT = {"grains": "coarse", "seconds": 1.2}


@pytest.fixture(scope="module")
def env():
    return gymnasium.make("torchds/LwrDigging-v0", **SHORT).unwrapped


def play(env, action, seed=3):
    env.reset(seed=seed)
    total, ended, n = 0.0, False, 0
    while not ended:
        _, reward, ended, truncated, _ = env.step(action)
        total, n = total + reward, n + 1
        assert not truncated
    return total, n


@pytest.mark.slow
def test_both_libraries_find_nothing_wrong(env):
    check_env(env, skip_render_check=True)
    env_checker.check_env(env)


@pytest.mark.slow
def test_zero_actions_are_the_tasks_own_trial_on_the_same_bed(env, monkeypatch):
    total, n = play(env, np.zeros(4))
    bed = int(np.random.Generator(np.random.PCG64(3)).integers(2**31))
    task = tasks.make("lwr_digging", **SHORT)
    task.trials = bed
    path = task.rollout(task.policy().expand(1))
    assert n == 12
    np.testing.assert_allclose(path.plant.pose, env.recording().pose, rtol=0, atol=1e-9)
    assert -total == pytest.approx(float(task.cost(path)), abs=1e-9)


@pytest.mark.slow
def test_actions_move_the_reference_and_the_stiffness(env):
    env.reset(seed=3)
    env.step(np.array([1.0, 0.0, 0.0, 0.5]))
    env_stiffness, moved = float(env.trials.stiffness[-1]), env.reference.clone()
    assert env_stiffness == pytest.approx(1.5 * 150.0)
    env.reset(seed=3)
    env.step(np.zeros(4))
    assert moved[0] - env.reference[0] == pytest.approx(gym.PERIOD * float(env.unit[0]), rel=0.1)


@pytest.mark.slow
def test_what_the_arm_does_not_reach_ends_the_episode_at_its_price(env):
    env.unit = env.unit * 100
    try:
        total, n = play(env, np.array([1.0, 1.0, 0.0, 0.0]))
    finally:
        env.unit = env.unit / 100
    assert total == pytest.approx(-gym.FAILED) and n < 12


@pytest.mark.slow
def test_a_picture_shows_the_arm():
    from tasks.digging.rendering import NoRendererError

    env = gym.LwrDiggingEnv("rgb_array", **SHORT)
    env.reset(seed=0)
    try:
        picture = env.render()
    except NoRendererError:
        return
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    assert ((picture[..., 0] > 150) & (picture[..., 2] < 90)).sum() > 5000
    assert gym.LwrDiggingEnv(**SHORT).render() is None and torch.is_tensor(env.reference)
