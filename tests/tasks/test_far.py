"""All tasks but the digging on a device that is not there: the same costs, and no tensor left behind."""

import copy

import pytest
import torch
from torch.testing import assert_close

import tasks
from tests.far import FAR, pretended
from torchds import GaussianMixture, load_lasa
from torchds.errors import InvalidArgumentError

NAMES = ("via_point", "two_starts", "constrained_reaching", "divergent_field", "half_plane_force")


@pytest.fixture(scope="module")
def mixture():
    return GaussianMixture.fit(load_lasa("NShape", 2, scale=0.2).every(20), 2, n_init=1, tol=1e-2)


@pytest.mark.parametrize("convention", ["paper", "released"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_a_trial_costs_the_same_there(name, convention, mixture, monkeypatch):
    here = tasks.make(name, convention=convention, mixture=mixture)
    motion = here.motion()
    monkeypatch.setattr(type(here), "motion", lambda task: motion._replace(x0=motion.x0.to(task.goal), n_steps=10))
    policy = here.policy()
    cost = here.step_costs(here.rollout(policy))
    with pretended():
        there = copy.deepcopy(here).to(FAR)
        moved = there.policy()
        path, terms = there.evaluate(moved)
        far = [there.step_costs(path), *terms.values(), *there.diagnostics(path).values(), there.scene().goal]
        assert {value.device for value in far} == {moved.A.device} == {FAR}
        assert_close(far[0].to("cpu").detach(), cost.detach(), rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_what_a_task_makes_later_follows_it():
    task = tasks.make("via_point", demonstrations=load_lasa("NShape", 2, scale=0.25).every(20)).to(dtype=torch.float32)
    assert task.demonstrations[0].x.dtype == task.mixture.means.dtype == task.policy().A.dtype == torch.float32
    assert task.cost(task.rollout(task.policy())).dtype == torch.float32
    assert task.scene().goal.dtype == task.via_points.dtype == torch.float32
    task.mixture = task.mixture.to(dtype=torch.float64)  # given now
    assert task.mixture.means.dtype == torch.float32


def test_the_digging_stays_on_the_cpu():
    pytest.importorskip("mujoco")
    task = tasks.make("lwr_digging", grains="coarse")
    assert task.to("cpu") is task
    with pytest.raises(
        InvalidArgumentError, match="trials of lwr_digging are made on the CPU alone, got cuda; leave it out"
    ):
        task.to("cuda")
