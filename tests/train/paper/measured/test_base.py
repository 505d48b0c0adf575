"""What is measured of every learning run, against loops and closed forms."""

import itertools

import numpy as np
import pytest
import torch

from train.paper.measured import base


@pytest.fixture
def quick(monkeypatch):
    """Two updates, whatever the task says."""
    monkeypatch.setattr("train.learning.learner.n_updates", lambda *_: 2)
    base.learned.cache_clear()
    yield
    base.learned.cache_clear()


@pytest.mark.slow
def test_learning_runs_are_made_once_for_one_question(quick):
    one = base.learned("via_point", 2, 0, shape="N")
    assert base.learned("via_point", 2, 0, shape="N") is one
    other = base.learned("via_point", 2, 1, shape="N")
    assert other is not one and other.options.seed == 1
    cost = base.course(one)
    assert cost.shape == (3, 2) and cost[0, 0] == cost[0, 1]  # all start from one policy
    np.testing.assert_allclose(sum(base.course(one, term) for term in one.history.terms), cost, rtol=1e-12)


def test_the_early_share_of_a_line_is_a_quarter_and_that_of_a_decay_is_more():
    t = np.linspace(0, 1, 41)[:, None]
    assert base.early_share(3 - 2 * t) == pytest.approx(0.25)
    assert base.early_share(np.exp(-5 * t)) == pytest.approx((1 - np.exp(-1.25)) / (1 - np.exp(-5)))


def test_distances_to_via_points_are_those_of_loops(randn):
    x, points = randn(3, 6, 2), randn(4, 2)
    found = base.via_distances(x, points)
    for i, l in itertools.product(range(3), range(4)):
        assert float(found[i, l]) == pytest.approx(min(float((x[i, t] - points[l]).norm()) for t in range(1, 6)))


def test_the_extent_is_the_diagonal_of_the_box():
    corners = torch.tensor([[[0.0, 1.0], [3.0, 2.0]], [[1.0, 5.0], [2.0, 3.0]]])
    assert base.extent(corners) == pytest.approx(5.0)  # 3 by 4
