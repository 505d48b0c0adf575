"""What a state has to be (tests/faults/test_optimizer.py edits it anywhere)."""

import pytest
import torch
from torch import nn

from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB


def make(*shapes, **options):
    parameters = [nn.Parameter(torch.zeros(*shape, dtype=torch.float64)) for shape in shapes]
    return PIBB(parameters, Gaussian(0.1), n_rollouts=4, **options)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (make((2,), elite="best"), "group 0 has to have the parameters 0 to 1"),
        (make((2,), (4,), elite="best"), r"'best' of parameter 1 with the shape \(3,\) has to be \(\*shape\)"),
        (torch.optim.Adam([nn.Parameter(torch.zeros(2))]), r"\['generator', 'explorations'\] are not in it"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_by_what_differs(other, message):
    if isinstance(other, PIBB):
        other.step(lambda: torch.arange(4.0))
    optim = make((2,), (3,), elite="best")
    with pytest.raises(InvalidArgumentError, match=message):
        optim.load_state_dict(other.state_dict())
    assert not optim.state


def test_a_class_that_names_its_entries_refuses_others_and_one_that_inherits_them_does_not():
    class Own(PIBB):
        """Keeps what it likes."""

    theta = nn.Parameter(torch.zeros(2))
    own, plain = Own([theta], Gaussian(0.1)), PIBB([theta], Gaussian(0.1))
    for optim in (own, plain):
        state = {**optim.state_dict(), "state": {0: {"mine": torch.ones(3, dtype=torch.int64)}}}
        if optim is plain:
            with pytest.raises(InvalidArgumentError, match=r"PIBB keeps .* got \['mine'\]"):
                optim.load_state_dict(state)
        else:
            optim.load_state_dict(state)
            assert optim.state[theta]["mine"].dtype == torch.int64
