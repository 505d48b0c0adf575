import json
import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

import tasks
from tasks.gym import TaskVectorEnv
from torchds.errors import InvalidArgumentError, MissingPackageError
from train.deep_rl import agents
from train.deep_rl.command import DeepRL


def results(tmp_path, **options):
    folder = DeepRL("ViaPointN", logdir=tmp_path, **options).main()
    return folder, json.loads((folder / "results.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("optimizer", ["ppo", "sac"])
def test_a_run_leaves_results_like_those_of_the_other_optimizers(optimizer, tmp_path):
    state = torch.get_rng_state(), np.random.get_state()[1].copy()
    folder, content = results(tmp_path, optimizer=optimizer, runs=2, updates=2, rollouts=2)
    assert folder.parent.parts[-2:] == ("via_point", optimizer)
    assert content["task"] == "via_point" and content["options"]["shape"] == "N"
    assert content["rollouts"] == [0, 2, 4]
    assert [len(row) for row in content["cost"]] == [2] * 3
    for update in range(3):
        for r in range(2):
            parts = sum(term[update][r] for term in content["terms"].values())
            assert content["cost"][update][r] == pytest.approx(parts, rel=1e-12)
    assert content["cost"][-1][0] != content["cost"][0][0]
    for name in ("agent-1.zip", "normalization-1.pkl"):
        assert (folder / name).stat().st_size > 0
    assert torch.equal(torch.get_rng_state(), state[0]) and (np.random.get_state()[1] == state[1]).all()


@pytest.mark.slow
def test_a_run_depends_on_its_seed_alone(tmp_path):
    _, both = results(tmp_path, runs=2, updates=1, rollouts=2)
    _, second = results(tmp_path, runs=1, seed=1, updates=1, rollouts=2)
    assert [row[1:] for row in both["cost"]] == second["cost"]
    assert both["cost"][-1][0] != both["cost"][-1][1]


@pytest.mark.slow
def test_agents_begin_at_the_demonstrated_policy(tmp_path):
    _, content = results(tmp_path, runs=1, updates=1, rollouts=2)
    task = tasks.make("via_point")
    with torch.no_grad():
        assert content["cost"][0][0] == pytest.approx(float(task.cost(task.rollout(task.policy()))), rel=0.1)


@pytest.mark.slow
def test_stable_baselines3_gets_the_last_observation_of_an_episode():
    batch = agents.Batch(TaskVectorEnv("two_starts", 2))
    start = batch.reset()
    for t in range(200):
        observations, rewards, ended, infos = batch.step(np.zeros((2, 4), dtype=np.float32))
        assert rewards.shape == (2,) and ended.all() == (t == 199)
        assert (infos[0] == {}) == (t < 199)
    np.testing.assert_array_equal(observations, start)
    assert infos[1]["terminal_observation"][-1] == 0  # no time left
    assert start[1, -1] == 1


@pytest.mark.parametrize("name", ["runs", "updates", "rollouts"])
def test_wrong_options_are_refused_before_a_folder_is_made(name, tmp_path):
    with pytest.raises(InvalidArgumentError, match=f"--{name} has to be at least 1, got 0"):
        results(tmp_path, **{name: 0})
    assert not list(tmp_path.iterdir())


def test_without_stable_baselines3_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"'stable-baselines3'.*torchds\[baselines\]"):
        runpy.run_path(str(Path(agents.__file__)))
