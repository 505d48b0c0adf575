"""Exploration decays against line 11 of Algorithm 1."""

import pickle

import pytest
import torch
from torch.optim.lr_scheduler import LambdaLR

from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB, InverseIteration


@pytest.mark.parametrize("floor", [0.1, 0.3, 1.0])
def test_the_squared_learning_rate_is_line_11_of_algorithm_1(floor):
    theta = torch.nn.Parameter(torch.zeros(1))
    optim = PIBB([theta], exploration=Gaussian(1.0), n_rollouts=2, lr=0.5)
    decay = LambdaLR(optim, InverseIteration(floor))
    for n_iter in range(1, 30):
        assert optim.param_groups[0]["lr"] ** 2 == pytest.approx(0.25 * max(1 / n_iter, floor), rel=1e-12)
        optim.step(lambda: theta[..., 0])
        decay.step()


@pytest.mark.parametrize("floor", [0.0, -0.1, 1.5, float("nan")])
def test_a_floor_out_of_range_is_refused(floor):
    with pytest.raises(InvalidArgumentError, match=r"floor has to be in \(0, 1\], got"):
        InverseIteration(floor)


def test_it_can_be_pickled_and_compared():
    assert pickle.loads(pickle.dumps(InverseIteration(0.25))) == InverseIteration(0.25) != InverseIteration(0.5)


def test_lambda_lr_saves_it(tmp_path):
    def scheduler(floor):
        return LambdaLR(PIBB([torch.nn.Parameter(torch.zeros(1))], Gaussian(1.0)), InverseIteration(floor))

    torch.save(scheduler(0.25).state_dict(), tmp_path / "decay.pt")
    other = scheduler(0.9)
    other.load_state_dict(torch.load(tmp_path / "decay.pt", weights_only=True))
    assert other.lr_lambdas == [InverseIteration(0.25)]
