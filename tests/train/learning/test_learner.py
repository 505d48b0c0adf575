"""A learner, its hooks, and how it goes on."""

import pytest
import torch

from tests.motions import Short
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from train.learning.learner import Learner
from train.options import options_for


@pytest.fixture(scope="module")
def task():
    return Short()


def options(**given):
    return options_for("via_point", **{"runs": 2, "updates": 3, "rollouts": 5, **given})


@pytest.mark.slow
def test_what_wraps_the_trials_sees_each_of_them_and_changes_nothing_by_looking(task):
    seen = []

    def watch(closure, learner):
        def watched():
            seen.append(learner.policy.batch_shape)
            return closure()

        return watched

    plain = Learner(options(), task).learn()
    watched = Learner(options(), task, wrap=watch).learn()
    assert watched.history.cost == plain.history.cost
    assert seen == [(5, 2)] * 3


def test_what_wraps_the_trials_decides_what_they_cost(task):
    """Costs that are upside down make a policy worse."""
    better, worse = (
        Learner(options(updates=8, rollouts=10), task, wrap=wrap).learn()
        for wrap in (None, lambda closure, _: lambda: -closure())
    )
    assert sum(better.history.cost[-1]) < sum(better.history.cost[0]) < sum(worse.history.cost[-1])


@pytest.mark.parametrize("optimizer", ["pibb", "cma"])
def test_the_exploration_can_be_given(task, optimizer):
    made = []

    def explore(task, policy):
        made.append(policy.batch_shape)
        return Gaussian(0.01)

    given = Learner(options(optimizer=optimizer), task, exploration=explore).learn()
    named = Learner(options(optimizer=optimizer, exploration="gaussian", noise=0.01), task).learn()
    assert made == [(2,)]
    assert given.history.cost == named.history.cost


def test_a_restart_with_the_same_policy_changes_nothing(task):
    """Width, decay and draws go on, and so does the noise in the costs; trials stay wrapped."""
    wrapped = []

    def watch(closure, learner):
        wrapped.append(learner.policy)
        return closure

    whole = Learner(options(cost_noise=0.1), task).learn()
    mine = Learner(options(cost_noise=0.1), task, wrap=watch)
    mine.start()
    mine.update()
    copied = mine.initial.expand(2)
    copied.load_state_dict(mine.policy.state_dict())
    mine.restart(copied)
    assert mine.policy is copied and wrapped[-1] is copied and len(wrapped) == 2
    assert mine.learn().history.cost == whole.history.cost


def test_searches_in_fixed_coordinates_cannot_restart(task):
    mine = Learner(options(optimizer="adam"), task)
    before = mine.policy
    with pytest.raises(InvalidArgumentError, match="cannot go on with other policies"):
        mine.restart(mine.initial.expand(2))
    assert mine.policy is before


def test_the_initial_policy_is_evaluated_once_and_first(task):
    mine = Learner(options(), task)
    assert mine.done == 0 and mine.path is None
    mine.start()
    mine.start()
    assert len(mine.history.cost) == 1 and mine.done == 0
    with torch.no_grad():
        expected = task.evaluate(mine.initial)[1]
    assert mine.history.cost[0] == pytest.approx([float(sum(expected.values()))] * 2, rel=1e-12)
