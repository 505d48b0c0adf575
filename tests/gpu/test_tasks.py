"""On a GPU: every task but the digging, and optimizers × explorations, against the CPU."""

import copy

import pytest
import torch
from torch.testing import assert_close

import tasks
from torchds import GaussianMixture, load_lasa
from train.learning.learner import Learner
from train.options import options_for

pytestmark = pytest.mark.gpu

NAMES = ("via_point", "two_starts", "constrained_reaching", "divergent_field", "half_plane_force")


@pytest.mark.parametrize("convention", ["paper", "released"])
@pytest.mark.parametrize("name", NAMES)
def test_a_trial_costs_the_same(name, convention, tmp_path):
    given = {}
    if convention == "released":
        demos = load_lasa("NShape", 3, scale=0.2).every(10)
        given = {"mixture": GaussianMixture.fit(demos, 3, n_init=1)}
    here = tasks.make(name, convention=convention, **given)
    policy = here.policy()
    there = copy.deepcopy(here).to("cuda")
    _, terms = here.evaluate(policy)
    _, far = there.evaluate(there.policy())
    for term, value in terms.items():
        assert far[term].is_cuda
        scale = max(float(value.detach().abs()), 1.0)
        assert_close(far[term].cpu().detach(), value.detach(), rtol=0, atol=1e-8 * scale)


@pytest.mark.parametrize("exploration", ["homogeneous", "gaussian", "trajectory"])
@pytest.mark.parametrize("optimizer", ["pibb", "pi2", "pi2cma", "surrogate", "adam", "nes"])
def test_a_run_learns_the_same(optimizer, exploration):
    """Up to round-off, which an update makes larger."""
    costs = {}
    for device in ("cpu", "cuda"):
        chosen = options_for(
            "via_point", optimizer=optimizer, exploration=exploration, device=device, runs=2, updates=2, rollouts=5
        )
        learner = Learner(chosen).learn()
        assert learner.policy.A.device.type == device
        costs[device] = torch.tensor(learner.history.cost)
    assert_close(costs["cuda"], costs["cpu"], rtol=1e-7, atol=1e-9)
