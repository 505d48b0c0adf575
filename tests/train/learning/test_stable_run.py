"""The commands of the constrained reach: every stable exploration runs, and its certificate is logged."""

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.testing import assert_close

from torchds.errors import InvalidArgumentError
from torchds.exploration import Stable, TrajectorySpace
from train.learning.learner import Learner
from train.learning.run import run
from train.options import options_for


@pytest.fixture(scope="module")
def task():
    return Learner(options_for("constrained_reaching")).task


@pytest.mark.slow
def test_the_certificate_of_every_update_is_logged(undrawn, tmp_path):
    folder = run(options_for("constrained_reaching", runs=2, updates=3, rollouts=5, logdir=tmp_path))
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    eigenvalues = [event.value for event in events.Scalars("stability/largest_eigenvalue")]
    assert len(eigenvalues) == 4
    assert max(eigenvalues) < 0


@pytest.mark.slow
def test_zero_violations_over_a_full_training_run(task):
    learner = Learner(options_for("constrained_reaching", runs=3, exploration="stable-trajectory"), task)
    learner.start()
    assert learner.n_updates == 100
    for _ in range(learner.n_updates):
        learner.update()
        assert learner.searcher.optim.explorations[0].scalars()["stability/largest_eigenvalue"] < 0
        assert learner.policy.certificate(task.goal).stable.all()


@pytest.mark.parametrize("shrink", ["all", "direction", "none"])
def test_options_reach_the_exploration(task, shrink):
    made = Learner(options_for("constrained_reaching", noise=0.07, shrink=shrink), task).searcher.optim.explorations[0]
    assert isinstance(made, Stable)
    assert (made.raw.std, made.shrink, made.P) == (0.07, shrink, None)
    options = options_for("constrained_reaching", exploration="stable-trajectory", noise=0.4, shrink=shrink)
    made = Learner(options, task).searcher.optim.explorations[0]
    assert isinstance(made.raw, TrajectorySpace)
    usual = Learner(
        options_for("constrained_reaching", exploration="stable-trajectory"), task
    ).searcher.optim.explorations[0]
    assert_close(made.raw.spread, 8 * usual.raw.spread)  # 0.4 in place of a twentieth of the extent
    assert made.shrink == shrink
    assert made.raw.goal is not None


@pytest.mark.slow
def test_a_learned_metric_reaches_the_exploration():
    learner = Learner(options_for("constrained_reaching", condition="p-qlf"))
    assert learner.searcher.optim.explorations[0].P is learner.task.P


@pytest.mark.slow
def test_stable_exploration_of_a_policy_that_is_not_stable_is_refused():
    with pytest.raises(InvalidArgumentError, match="does not rest at the goal"):
        Learner(options_for("via_point", exploration="stable"))
