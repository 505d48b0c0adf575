"""Watched learning and the variants of Fig. 8, after two updates."""

import numpy as np
import pytest
import torch

import tasks
from torchds.exploration import Gaussian, Stable
from train.paper.measured import stable


@pytest.fixture
def quick(monkeypatch):
    """Two updates, whatever the task says."""
    monkeypatch.setattr("train.learning.learner.n_updates", lambda *_: 2)
    for kept in (stable.watched, stable.variant):
        kept.cache_clear()
    yield
    for kept in (stable.watched, stable.variant):
        kept.cache_clear()


@pytest.mark.slow
def test_every_roll_out_and_every_update_is_counted(quick):
    seen = stable.watched(3, 0)
    n = seen.learner.searcher.n_rollouts
    assert seen.tried == (2 * n * 3, 2 * n * 3) and seen.reached == (6, 6)
    assert stable.certified(seen.learner).tolist() == [True] * 3
    with torch.no_grad():
        seen.learner.policy.A[1] *= -1  # what grows is not certified
    assert stable.certified(seen.learner).tolist() == [True, False, True]


@pytest.mark.slow
def test_a_variant_learns_all_levels_in_one_batch(quick):
    found = stable.variant(stable.FREE, 2, 0)
    shape = (len(stable.LEVELS), 2)
    assert found.cost.shape == (3, *shape) and found.share.shape == shape
    assert len(set(found.cost[0].ravel().tolist())) == 1  # one policy at the beginning
    assert not np.array_equal(found.cost[-1, 0], found.cost[-1, -1])
    assert len(found.stable) == len(found.colliding) == len(stable.LEVELS)
    assert ((found.share >= 0) & (found.share <= 1)).all()
    shown = stable.variant(stable.SCHEDULED, 2, 0)
    assert shown.cost.shape == (3, 1, 2) and shown.stable == [2]


@pytest.mark.slow
def test_the_noise_of_each_variant_is_as_large_as_its_level():
    task = tasks.make(stable.TASK)
    std = torch.tensor([0.01, 0.02], dtype=torch.float64)
    policy = task.policy().expand(2)
    for name in (stable.STABLE, stable.TIED):
        made = stable.exploration_of(task, policy, name, std)
        assert isinstance(made, Stable)
    for name in (stable.FREE, stable.HOMOGENEOUS):
        made = stable.exploration_of(task, policy, name, std)
        assert isinstance(made, Gaussian)
        parameters = list(policy.parameters())
        for noise in made(parameters, [torch.ones(1, *p.shape, dtype=p.dtype) for p in parameters]):
            torch.testing.assert_close(noise[0, 1], 2 * noise[0, 0], rtol=1e-12, atol=0)
