"""What all searchers promise: noise in the costs, in the form that each of them takes."""

import pytest
import torch

from train.searchers.base import noisy


def generator():
    return torch.Generator().manual_seed(3)


def test_noise_is_normal_with_the_standard_deviation_that_was_asked_for():
    drawn = noisy(lambda: torch.full((20000,), 7.0, dtype=torch.float64), 0.5, False, generator())()
    assert float(drawn.mean()) == pytest.approx(7.0, abs=0.02)
    assert float(drawn.std()) == pytest.approx(0.5, rel=0.03)


def test_noise_of_costs_by_steps_is_in_the_last_step_alone_and_the_same_for_the_sum():
    steps = torch.arange(24, dtype=torch.float64).reshape(2, 3, 4)  # (N, runs, T)
    along = noisy(lambda: steps, 0.5, True, generator())()
    whole = noisy(lambda: steps.sum(-1), 0.5, False, generator())()
    assert torch.equal(along[..., :-1], steps[..., :-1])
    torch.testing.assert_close(along.sum(-1), whole, rtol=0, atol=1e-12)
    assert not torch.equal(whole, steps.sum(-1))


def test_without_noise_costs_stay():
    costs = torch.rand(3, 2, dtype=torch.float64, generator=generator())
    assert torch.equal(noisy(lambda: costs, 0.0, False, generator())(), costs)
