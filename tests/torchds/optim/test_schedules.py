"""Exploration decays against line 11 of Algorithm 1, and values by hand."""

import pickle

import pytest
import torch
from torch.optim.lr_scheduler import LambdaLR

from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB, ExponentialDecay, InverseIteration, LinearDecay


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


@pytest.mark.parametrize(
    ("decay", "factors"),
    [
        (LinearDecay(4, 0.1), [0.75, 0.5, 0.25, 0.1, 0.1, 0.1]),
        (LinearDecay(5, 0.5), [0.8, 0.6, 0.5, 0.5, 0.5]),
        (LinearDecay(1, 0.3), [0.3, 0.3]),
        (ExponentialDecay(4, 0.0625), [1.0, 0.5, 0.25, 0.125, 0.0625, 0.0625, 0.0625]),
        (ExponentialDecay(2, 0.25), [1.0, 0.5, 0.25, 0.25]),
        (ExponentialDecay(3, 1.0), [1.0, 1.0, 1.0, 1.0, 1.0]),
        (InverseIteration(0.25), [1.0, 0.5**0.5, 3**-0.5, 0.5, 0.5]),
    ],
)
def test_the_factors_of_the_first_updates_by_hand(decay, factors):
    assert [decay(epoch) for epoch in range(len(factors))] == pytest.approx(factors, rel=1e-14)


def test_the_linear_decay_is_that_of_the_released_program():
    """max(0.1, (N − i)/N) for i = 1..N, on the standard deviation."""
    theta = torch.nn.Parameter(torch.zeros(1))
    optim = PIBB([theta], Gaussian(1.0), n_rollouts=2)
    decay = LambdaLR(optim, LinearDecay(50))
    for i in range(1, 51):
        assert optim.param_groups[0]["lr"] == pytest.approx(max(0.1, (50 - i) / 50), rel=1e-14)
        optim.step(lambda: theta[..., 0])
        decay.step()


@pytest.mark.parametrize("decay", [LinearDecay, ExponentialDecay])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_updates": 0}, "n_updates has to be at least 1, got 0"),
        ({"n_updates": -3}, "n_updates has to be at least 1, got -3"),
        ({"n_updates": float("nan")}, "n_updates has to be at least 1, got nan"),
        ({"n_updates": 10, "floor": 0.0}, r"floor has to be in \(0, 1\], got 0.0"),
        ({"n_updates": 10, "floor": 1.1}, r"floor has to be in \(0, 1\], got 1.1"),
        ({"n_updates": 10, "floor": float("nan")}, r"floor has to be in \(0, 1\], got nan"),
    ],
)
def test_decays_out_of_range_are_refused(decay, options, message):
    with pytest.raises(InvalidArgumentError, match=message):
        decay(**options)


@pytest.mark.parametrize("decay", [LinearDecay, ExponentialDecay])
def test_decays_can_be_pickled_compared_and_saved(decay, tmp_path):
    assert pickle.loads(pickle.dumps(decay(20, 0.25))) == decay(20, 0.25)
    assert decay(20, 0.25) != decay(20, 0.5)
    assert decay(20, 0.25) != decay(30, 0.25)

    def scheduler(chosen):
        return LambdaLR(PIBB([torch.nn.Parameter(torch.zeros(1))], Gaussian(1.0)), chosen)

    torch.save(scheduler(decay(20, 0.25)).state_dict(), tmp_path / "decay.pt")
    other = scheduler(decay(7))
    other.load_state_dict(torch.load(tmp_path / "decay.pt", weights_only=True))
    assert other.lr_lambdas == [decay(20, 0.25)]
