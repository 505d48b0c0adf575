"""On a GPU: every task but the digging, and optimizers × explorations, against the CPU."""

import copy
import io

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


def learned(device, name="via_point", **options):
    """A learner of that device, after two updates."""
    chosen = options_for(name, device=device, **{"runs": 2, "updates": 2, "rollouts": 5} | options)
    learner = Learner(chosen).learn()
    assert learner.policy.A.device.type == device
    return learner


def assert_alike(one, other):
    """Up to round-off, which an update makes larger."""
    assert_close(torch.tensor(one.history.cost), torch.tensor(other.history.cost), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("exploration", ["homogeneous", "gaussian", "trajectory"])
@pytest.mark.parametrize("optimizer", ["pibb", "pi2", "pi2cma", "surrogate", "adam", "nes"])
def test_a_run_learns_the_same(optimizer, exploration):
    chosen = {"optimizer": optimizer, "exploration": exploration}
    assert_alike(learned("cuda", **chosen), learned("cpu", **chosen))


@pytest.mark.parametrize("name", ["half_plane_force", "divergent_field"])
def test_a_run_by_chance_learns_the_same(name):
    chosen = {"sensor_noise": 0.02, "pushes": 5.0, "cost_noise": 0.1}
    assert_alike(learned("cuda", name, **chosen), learned("cpu", name, **chosen))


def test_a_checkpoint_moves():
    here, there = learned("cpu"), learned("cuda")
    saved = io.BytesIO()
    torch.save(there.state_dict(), saved)
    saved.seek(0)
    back = learned("cpu", updates=0)
    back.load_state_dict(torch.load(saved, map_location="cpu"))
    forth = learned("cuda", updates=0)
    forth.load_state_dict(here.state_dict())
    for learner in (back, forth):
        learner.update()
    assert_alike(forth, back)
