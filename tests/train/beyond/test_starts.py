"""Learning for several starts from trials of one start each."""

import numpy as np
import pytest
import torch

import tasks
from torchds import rollout
from torchds.errors import InvalidArgumentError
from train.beyond.starts import comparable, one_start


def test_comparable_starts_have_one_minimum_and_spread_and_keep_their_order(randn):
    costs = randn(8, 5).exp() * torch.tensor([1.0, 100.0]).repeat(4).unsqueeze(-1)
    each, scaled = (c.unflatten(0, (4, 2)).numpy() for c in (costs, comparable(costs, 2, "range")))
    low, high = each.min(0).mean(0), each.min(0).mean(0) + np.ptp(each, 0).mean(0)
    np.testing.assert_allclose(scaled.min(0), [low, low], rtol=1e-12)
    np.testing.assert_allclose(scaled.max(0), [high, high], rtol=1e-12)
    assert (scaled.argsort(0) == each.argsort(0)).all()


def test_failed_and_equal_costs_stay_what_they_are():
    costs = torch.tensor([1.0, 5.0, torch.nan, 5.0, 3.0, 5.0])
    assert comparable(costs, 2, "capped").tolist() == [3.0, 3.0, float("inf"), 3.0, 4.0, 3.0]


@pytest.mark.slow
def test_each_policy_is_tried_from_its_own_start(task, randn):
    policy = task.policy().expand(4, 3)
    policy.unpack(policy.pack().detach() + 1e-3 * randn(*policy.pack().shape))
    starts, n_steps, dt = task.motion()
    alone = [task.cost(rollout(policy[n], starts[n % 2 : n % 2 + 1], n_steps, dt)) for n in range(4)]
    expected = comparable(torch.stack(alone), 2, "range")
    torch.testing.assert_close(one_start(task, policy, 4, "range")(), expected, atol=1e-9, rtol=1e-9)


@pytest.mark.slow
def test_tasks_without_several_starts_and_uneven_shares_are_refused(task):
    with pytest.raises(InvalidArgumentError, match="does not have several starts"):
        one_start(tasks.make("via_point"), tasks.make("via_point").policy(), 4, "range")
    with pytest.raises(InvalidArgumentError, match="5 roll-outs cannot be shared evenly by 2 starts"):
        one_start(task, task.policy(), 5, "range")
