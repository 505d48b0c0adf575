"""Noise: drawn once, none for what is frozen, and never one that is not finite."""

import pytest
import torch
from torch import nn

from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB


def make(*shapes, **options):
    parameters = [nn.Parameter(torch.zeros(*shape, dtype=torch.float64)) for shape in shapes]
    return PIBB(parameters, Gaussian(0.1), n_rollouts=4, **options)


def test_freezing_a_parameter_does_not_change_the_noise_of_the_others():
    whole, part = make((2,), (3,)), make((2,), (3,))
    part.param_groups[0]["params"][0].requires_grad_(False)
    (_, expected), (none, found) = whole.ask(), part.ask()
    assert torch.equal(found, expected) and not none.any()


def test_noise_beyond_the_largest_number_is_refused():
    optim = make((2,), lr=1e308)
    with pytest.raises(InvalidArgumentError, match="is not finite; explore less"):
        optim.ask([[torch.full((4, 2), 1e3)]])
