"""Explorations by name, with the sizes that the options or the task give them."""

import pytest
import torch

from tests.motions import Short
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous, TrajectorySpace
from train.options import options_for
from train.searchers.explorations import along_motion, make_exploration


@pytest.fixture(scope="module")
def task():
    return Short()


@pytest.mark.parametrize(
    ("name", "kind"), [("homogeneous", Homogeneous), ("gaussian", Gaussian), ("trajectory", TrajectorySpace)]
)
def test_every_name_is_one_exploration(task, name, kind):
    options = options_for("via_point", exploration=name)
    assert isinstance(make_exploration(options, task, task.policy()), kind)
    assert along_motion(options) == (kind is TrajectorySpace)


def test_the_size_of_homogeneous_noise_is_the_one_given(task):
    policy = task.policy()
    one, two = (make_exploration(options_for("via_point", noise=size), task, policy).std() for size in (0.1, 0.2))
    for name in one:
        torch.testing.assert_close(two[name], 2 * one[name])


def test_stiffness_or_motion_alone_is_perturbed_where_that_is_asked():
    from tasks import make

    task = make("divergent_field")
    policy = task.policy()
    for learn, still in (("motion", "stiffness_A"), ("stiffness", "A")):
        std = make_exploration(options_for("divergent_field", learn=learn), task, policy).std()
        assert [name for name in ("A", "stiffness_A") if not std[name].any()] == [still]
    with pytest.raises(InvalidArgumentError, match="--learn motion goes with --exploration homogeneous"):
        make_exploration(options_for("divergent_field", learn="motion", exploration="trajectory"), task, policy)
