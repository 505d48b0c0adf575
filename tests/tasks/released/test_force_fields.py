"""The force fields of the authors' program: what they are learned from, and starts that are too soft.

Their costs and forces are held to the same loops as the paper's, in `tests/tasks/force_fields`.
"""

import functools

import numpy as np
import pytest
import torch

import tasks
from tests.force_fields import synthetic, synthetic_mixture
from torchds.errors import DemonstrationWarning, InvalidArgumentError
from train.learning.learner import Learner
from train.options import options_for


@functools.cache
def field(**options):
    return tasks.make("divergent_field", convention="released", demonstrations=synthetic(), **options)


def test_the_released_problem_without_data_says_what_to_give():
    task = tasks.make("divergent_field", convention="released")
    with pytest.raises(InvalidArgumentError, match=r"no demonstrations.*give demonstrations=PATH or mixture=PATH"):
        task.policy()


@pytest.mark.slow
def test_stiffness_in_a_given_mixture_gives_way_to_the_initial_one():
    """Also where a constant column has made a mixture that is nearly singular."""
    mixture = field().mixture
    means = torch.cat([mixture.means, torch.full((3, 2), 33.0, dtype=torch.float64)], -1)
    covariances = torch.stack([torch.block_diag(c, 1e-9 * torch.eye(2).double()) for c in mixture.covariances])
    joint = type(mixture)(mixture.priors, means, covariances)
    given = tasks.make("divergent_field", convention="released", mixture=joint, initial_stiffness=7.0)
    plain = field(initial_stiffness=7.0)
    with pytest.warns(DemonstrationWarning, match=r"2 variable\(s\) .* left out: the released program begins with"):
        policy = given.policy()
    torch.testing.assert_close(policy.pack(), plain.policy().pack(), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_a_start_that_diverges_is_learned_from():
    """1 N/m cannot hold the mass in a field of 10 N/m."""
    options = options_for("divergent_field", runs=20, updates=50, convention="released", initial_stiffness=1.0)
    learner = Learner(options, field(initial_stiffness=1.0)).learn()
    costs = np.array(learner.history.cost)
    assert costs[0].min() > 1e10
    assert np.isfinite(costs).all()
    assert all(p.isfinite().all() for p in learner.policy.parameters())
    assert np.median(costs[-1]) < 3
    assert costs[-1].max() < 100


@pytest.mark.slow
def test_the_released_problem_is_learned_from_a_start_that_is_too_soft():
    """1 N/m against 10 N."""
    options = options_for("half_plane_force", runs=5, updates=30, convention="released", initial_stiffness=1.0)
    costs = np.array(
        Learner(
            options,
            tasks.make("half_plane_force", convention="released", mixture=synthetic_mixture(), initial_stiffness=1.0),
        )
        .learn()
        .history.cost
    )
    assert np.isfinite(costs).all()
    assert (costs[-1] < 0.2 * costs[0]).all()
