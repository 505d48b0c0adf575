"""Learning on a device that is not there: the same costs as on the CPU, and checkpoints that move between the two."""

from dataclasses import replace
from functools import partial

import pytest
import torch
from torch.testing import assert_close

from tasks import via_point
from tests.far import FAR, pretended
from torchds import GaussianMixture, load_lasa
from torchds.devices import moved
from torchds.errors import InvalidArgumentError
from train.folder import RunFolder
from train.learning import figures
from train.learning.learner import Learner
from train.options import options_for


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """The N in five steps."""
    monkeypatch.setattr(via_point.ViaPoint, "setups", {"N": replace(via_point.N, duration=1.0)})


@pytest.fixture(scope="module")
def options(tmp_path_factory):
    path = tmp_path_factory.mktemp("mixture") / "mixture.npz"
    GaussianMixture.fit(load_lasa("NShape", 2, scale=0.25).every(50), 2, n_init=1, tol=1e-2).save(path)
    return partial(options_for, "via_point", runs=2, updates=2, rollouts=3, mixture=path)


@pytest.mark.parametrize(
    ("optimizer", "exploration"),
    [
        ("pibb", "homogeneous"),
        pytest.param("pi2", "gaussian", marks=pytest.mark.slow),
        pytest.param("pi2cma", "trajectory", marks=pytest.mark.slow),
        pytest.param("surrogate", "trajectory", marks=pytest.mark.slow),
        pytest.param("adam", "homogeneous", marks=pytest.mark.slow),
        pytest.param("nes", "gaussian", marks=pytest.mark.slow),
    ],
)
def test_a_run_learns_the_same_there_and_its_checkpoint_moves(optimizer, exploration, options):
    chosen = options(optimizer=optimizer, exploration=exploration, cost_noise=0.01)
    here = Learner(chosen).learn()
    with pretended():
        there = Learner(chosen, chosen.make_task().to(FAR)).learn()
        assert there.policy.A.device == FAR
        assert_close(torch.tensor(there.history.cost), torch.tensor(here.history.cost), rtol=1e-9, atol=0)
        back, forth = Learner(chosen), Learner(chosen, chosen.make_task().to(FAR))
        back.load_state_dict(moved(there.state_dict(), "cpu"))
        forth.load_state_dict(here.state_dict())
        for learner in (back, forth):
            learner.update()
        assert back.policy.A.device == torch.device("cpu") and forth.policy.A.device == FAR
        assert_close(torch.tensor(forth.history.cost), torch.tensor(back.history.cost), rtol=1e-9, atol=0)


def test_a_run_goes_on_from_its_folder_on_another_device(options, tmp_path):
    begun, folder = Learner(options()), RunFolder(tmp_path)
    begun.start()
    begun.update()
    folder.save_checkpoint(begun)
    other = Learner(options())
    other.options = replace(other.options, device="cuda")  # as it is begun where there is a GPU
    folder.restore(other)
    assert other.done == 1 and torch.equal(other.policy.pack(), begun.policy.pack())


@pytest.mark.slow
def test_the_figures_of_a_run_are_drawn_from_there(options):
    chosen = options()
    with pretended():
        learner = Learner(chosen, chosen.make_task().to(FAR)).learn()
        assert set(figures.of_run(learner)) == {"motion", "learning_curves"}


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_refused_before_anything_is_made(options):
    with pytest.raises(
        InvalidArgumentError, match=r"--device cuda needs a GPU that torch can use, got none .*--device cpu"
    ):
        options(device="cuda").make_task()
