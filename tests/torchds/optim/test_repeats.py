"""Trying each policy several times."""

import pytest
import torch

import torchds
from torchds.errors import InvalidArgumentError
from torchds.optim import PIBB, repeated


def noisy(policy, start, noise):
    """A closure whose calls take what is next in `noise`."""
    noise = iter(noise)

    def closure():
        return torchds.rollout(policy, start, 5, 0.1).x[..., -1, :].square().sum(-1) + next(noise)

    return closure


def learner(policy, weight=1e-3):
    return PIBB(policy.parameters(), torchds.exploration.Homogeneous(policy), n_rollouts=5, control_weight=weight)


def test_the_update_is_that_of_the_mean_of_single_trials(random_policy, randn):
    a, start, noise = random_policy(batch=(3,)), randn(2), 0.3 * randn(4, 5, 3)
    b = a.expand()
    one, other = learner(a), learner(b, weight=0.0)
    one.step(repeated(noisy(a, start, [noise]), list(a.parameters()), 4))
    single = noisy(b, start, noise)
    other.step(lambda: torch.stack([single() for _ in range(4)]).mean(0) + one.last.control)
    assert one.last.control.amax() > 0
    torch.testing.assert_close(one.last.cost, other.last.cost, atol=1e-12, rtol=0)
    torch.testing.assert_close(a.pack(), b.pack(), atol=1e-12, rtol=0)


def test_the_control_cost_is_that_of_one_trial(random_policy, randn):
    a, start = random_policy(batch=(3,)), randn(2)
    b = a.expand()
    one, other = learner(a), learner(b)
    one.step(repeated(noisy(a, start, [0.0]), a.parameters(), 4))
    other.step(noisy(b, start, [0.0]))
    assert torch.equal(one.last.control, other.last.control)


def test_the_noise_falls_with_the_root_of_the_repeats():
    theta, generator = torch.nn.Parameter(torch.zeros(2000, 1)), torch.Generator().manual_seed(0)
    closure = repeated(lambda: torch.randn(theta.shape[:-1], generator=generator), [theta], 16)
    assert float(closure().std()) == pytest.approx(0.25, rel=0.1)


def test_a_policy_one_of_whose_trials_failed_has_failed():
    theta = torch.nn.Parameter(torch.zeros(2))
    optim = PIBB([theta], torchds.exploration.Gaussian(0.3), n_rollouts=3)
    bad = torch.zeros(2, 3)
    bad[1, 2] = torch.nan
    optim.step(repeated(lambda: theta.square().sum(-1) + bad, [theta], 2))
    assert optim.last.failed.tolist() == [False, False, True]


def test_parameters_come_back_when_the_closure_raises():
    theta = torch.nn.Parameter(torch.ones(2))
    with pytest.raises(ZeroDivisionError):
        repeated(lambda: 1 / 0, [theta], 2)()
    assert theta.tolist() == [1.0, 1.0]


def test_less_than_one_repeat_is_refused():
    with pytest.raises(InvalidArgumentError, match="at least 1, got 0"):
        repeated(lambda: torch.zeros(()), [], 0)
