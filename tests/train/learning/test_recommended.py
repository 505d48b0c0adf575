"""The recommended learner, one setting for all tasks, against what PI^BB reaches with all of its roll-outs."""

import numpy as np
import pytest

from train.learning.learner import Learner
from train.options import options_for

RUNS, N = 20, 10  # seeds, roll-outs per update


def medians(task, **chosen):
    """Median cost of the noise-free policies of 20 seeds after each update; reward only."""
    learner = Learner(options_for(task, runs=RUNS, optimizer="surrogate", **chosen))
    assert learner.searcher.n_rollouts == N
    return np.median(learner.learn().history.cost, -1)


@pytest.mark.parametrize(("shape", "pibb", "end"), [("N", 0.156, 0.045), ("P", 0.455, 0.015)])
@pytest.mark.slow
def test_via_points(shape, pibb, end):
    """PI^BB ends at `pibb` after 500 roll-outs."""
    cost = medians("via_point", shape=shape, exploration="trajectory", updates=50)
    assert cost[200 // N] <= pibb
    assert cost[500 // N] <= end


@pytest.mark.parametrize(
    ("shape", "noise", "end"), [("N", 0.1, 0.45), ("P", 0.1, 0.2), ("N", 0.5, 1.8), ("P", 0.5, 1.0)]
)
@pytest.mark.slow
def test_noisy_costs(shape, noise, end):
    """Normals with a standard deviation of `noise` initial costs; the medians are of noise-free trials, after 500 roll-outs."""
    chosen = options_for(
        "via_point", shape=shape, runs=RUNS, optimizer="surrogate", exploration="trajectory", cost_noise=noise
    )
    learner = Learner(chosen).learn()
    costs = np.array(learner.history.cost)
    assert np.median(costs[-1]) <= end
    found = learner.searcher.scalars()["surrogate/noise"]
    assert noise / 2 < found / costs[0, 0] < 2 * noise


@pytest.mark.parametrize("shape", ["N", "P"])
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.5])
@pytest.mark.slow
def test_the_noise_is_known_after_a_hundred_roll_outs(shape, noise):
    """Mean over 20 runs, as TensorBoard has it, in initial costs."""
    options = options_for(
        "via_point",
        shape=shape,
        runs=RUNS,
        optimizer="surrogate",
        exploration="trajectory",
        cost_noise=noise,
        updates=10,
    )
    learner = Learner(options).learn()
    found = learner.searcher.scalars()["surrogate/noise"] / np.median(learner.history.cost[0])
    assert noise / 2 < found < 2 * noise if noise else found < 0.02


@pytest.mark.slow
def test_a_budget_of_four_hundred_roll_outs_does_what_a_thousand_did():
    """PI^BB ends at 0.355 after 1000 roll-outs. The tests of the force fields hold it to the same there."""
    cost = medians("constrained_reaching", exploration="stable-trajectory", updates=400 // N)
    assert cost[-1] <= 0.355
