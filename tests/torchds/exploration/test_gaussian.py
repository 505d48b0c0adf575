"""Independent noise: std · z, whatever the parameters are."""

import pytest
import torch
from torch import nn

from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration, Gaussian
from torchds.optim import PIBB


def make_parameters(dtype=torch.float64):
    return [nn.Parameter(torch.ones(2, 3, dtype=dtype)), nn.Parameter(torch.ones(2, dtype=dtype))]


def make_normals(parameters, n=4):
    generator = torch.Generator().manual_seed(1)
    return [torch.randn(n, *p.shape, dtype=p.dtype, generator=generator) for p in parameters]


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize(
    ("std", "each"),
    [
        (0.5, (0.5, 0.5)),
        (2, (2, 2)),
        ([0.5, 0.25], (0.5, 0.25)),
        ([torch.tensor([1.0, 2.0, 4.0]), 0.0], ([1.0, 2.0, 4.0], 0.0)),
        ([torch.tensor([[1.0], [3.0]]), torch.tensor([2.0, 8.0])], ([[1.0], [3.0]], [2.0, 8.0])),
    ],
)
def test_the_noise_is_the_standard_deviation_times_the_normals(std, each, dtype):
    parameters = make_parameters(dtype)
    normals = make_normals(parameters)
    exploration = Gaussian(std)
    exploration.check(parameters)
    for noise, z, s in zip(exploration(parameters, normals), normals, each, strict=True):
        assert noise.dtype == dtype
        # Powers of two and small integers scale without rounding.
        assert torch.equal(noise, torch.from_numpy(z.numpy() * torch.tensor(s, dtype=dtype).numpy()))


@pytest.mark.parametrize(
    "std", [-0.1, float("nan"), float("inf"), [0.1, -1.0], [torch.tensor([0.1, float("nan")]), 0.1]]
)
def test_a_standard_deviation_that_is_negative_or_not_finite_is_refused(std):
    with pytest.raises(InvalidArgumentError, match="std has to be finite and ≥ 0, got"):
        Gaussian(std)


@pytest.mark.parametrize(
    ("std", "message"),
    [
        ([0.1], r"1 values of std for 2 parameters \[\(2, 3\), \(2,\)\]"),
        ([0.1, torch.ones(3)], r"std of shape \(3,\) does not fit a parameter \(2,\)"),
        ([torch.ones(4, 2, 3), 0.1], r"std of shape \(4, 2, 3\) does not fit a parameter \(2, 3\)"),
    ],
)
def test_the_optimizer_refuses_a_standard_deviation_that_does_not_fit_its_parameters(std, message):
    with pytest.raises(InvalidArgumentError, match=message):
        PIBB(make_parameters(), exploration=Gaussian(std))


def test_nothing_of_it_changes_while_learning():
    exploration = Gaussian(0.3)
    assert isinstance(exploration, Exploration)
    assert exploration.state_dict() == {}
    exploration.load_state_dict({})
    assert exploration.std == 0.3
