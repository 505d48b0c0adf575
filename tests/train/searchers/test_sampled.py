"""Sampled search: the optimizer with its decay, its counts, and how it goes on with other policies."""

import pytest
import torch

from tests.motions import Short
from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from train.learning.learner import Learner
from train.options import options_for
from train.searchers.named import make_searcher
from train.searchers.sampled import factor


@pytest.fixture(scope="module")
def task():
    return Short()


def learner(task, **options):
    return Learner(options_for("via_point", **{"runs": 2, "updates": 4, "rollouts": 5, **options}), task)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("inverse", [1.0, (1 / 2) ** 0.5, (1 / 3) ** 0.5, 0.1**0.5]),  # of the standard deviation, updates 1, 2, 3, 40
        ("none", [1.0, 1.0, 1.0, 1.0]),
    ],
)
def test_decays_are_those_that_their_options_promise(name, expected):
    decay = factor(name, 100)
    assert [decay(n) for n in (0, 1, 2, 39)] == pytest.approx(expected)


def test_the_exponential_decay_ends_after_fifty_updates_or_with_the_run():
    assert factor("exponential", 400)(50) == pytest.approx(0.15)
    assert factor("exponential", 20)(20) == pytest.approx(0.15)
    assert [factor("linear", 20)(n) for n in (0, 9, 19)] == pytest.approx([0.95, 0.5, 0.1])


@pytest.mark.slow
def test_a_step_takes_the_decay_one_update_further(task):
    mine = learner(task, decay="inverse", scale=3.0)
    widths = []
    for _ in range(3):
        widths.append(mine.searcher.scalars()["exploration/lr"])
        mine.searcher.step(mine.closure)
    assert widths == pytest.approx([3.0, 3.0 / 2**0.5, 3.0 / 3**0.5])


@pytest.mark.slow
def test_the_first_numbers_to_log_are_those_of_the_noise_and_then_of_the_trials(task):
    mine = learner(task)
    assert not {"weights/entropy", "exploration/mean_cost"} & set(mine.searcher.scalars())
    mean = mine.searcher.step(mine.closure)
    found = mine.searcher.scalars()
    assert found["exploration/mean_cost"] == pytest.approx(float(mean.mean()))
    assert 0 < found["weights/entropy"] < torch.log(torch.tensor(5.0))  # equal weights have the largest entropy


def test_failed_trials_are_counted(task):
    mine = learner(task)
    assert mine.searcher.failed == 0

    def closure():
        costs = mine.closure()
        costs[1:3, 0] = torch.nan
        return costs

    mine.searcher.step(closure)
    assert mine.searcher.failed == 2


def failing(mine):
    """Trials that all fail."""
    return lambda: mine.closure() * torch.nan


@pytest.mark.parametrize("optimizer", ["surrogate", "pibb"])
def test_where_all_trials_fail_before_any_was_seen_the_search_ends(task, optimizer):
    mine = learner(task, optimizer=optimizer)
    with pytest.raises(AllRolloutsFailedError):
        mine.searcher.step(failing(mine))


def test_where_all_trials_fail_a_search_with_a_memory_goes_back_to_one_that_did_not(task):
    mine = learner(task, optimizer="surrogate", exploration="trajectory", updates=9)
    for _ in range(3):
        mine.searcher.step(mine.closure)
    before = mine.policy.pack().detach().clone()
    state = mine.searcher.optim.state
    tried = mine.policy.pack(lambda p: state[p]["tried"])  # (M, runs, P)
    cost = mine.searcher.step(failing(mine))
    now = mine.policy.pack().detach()
    assert cost.isfinite().all() and mine.searcher.failed == 2 * 5
    assert not torch.equal(now, before) and (tried == now).all(-1).any(0).all()
    assert torch.equal(mine.policy.pack(lambda p: state[p]["tried"]), tried)
    mine.searcher.step(mine.closure)
    assert mine.searcher.failed == 0


def test_the_jacobian_of_noise_along_the_motion_is_counted_in_every_update(task):
    plain, along = (learner(task, exploration=name).searcher for name in ("homogeneous", "trajectory"))
    assert plain.forward_equivalents(7) == 7 * 5
    assert along.forward_equivalents(7) == 7 * (5 + 2)


def test_a_search_follows_another_one_bit_for_bit(task):
    """A new optimizer on a copy of the policies makes the very update that the old one would have made."""
    mine = learner(task, decay="inverse")
    for _ in range(2):
        mine.searcher.step(mine.closure)
    copied = task.policy().expand(2)
    copied.load_state_dict(mine.policy.state_dict())
    after = make_searcher(mine.options, task, copied)
    after.follow(mine.searcher)
    state = mine.searcher.optim.generator.get_state()
    mine.searcher.step(mine.closure)
    mine.searcher.optim.generator.set_state(state)  # the two of them share it
    after.step(after.closure(task, copied))
    assert torch.equal(copied.pack(), mine.policy.pack())
    assert after.scalars()["exploration/lr"] == mine.searcher.scalars()["exploration/lr"]


def test_only_a_sampled_search_can_be_followed(task):
    sampled, fixed = learner(task).searcher, learner(task, optimizer="cma").searcher
    with pytest.raises(InvalidArgumentError, match="can follow another one only, not CoordinateSearch"):
        sampled.follow(fixed)
    with pytest.raises(InvalidArgumentError, match="cannot go on with other policies; use --optimizer pibb"):
        fixed.follow(sampled)
