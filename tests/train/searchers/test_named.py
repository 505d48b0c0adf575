"""Searchers by name: every name is one, and what does not go together is refused."""

from typing import get_args

import pytest

import tasks
from tests.motions import Short
from torchds.errors import InvalidArgumentError
from torchds.optim import PI2CMA
from train.learning.learner import Learner
from train.options import Optimizer, options_for
from train.searchers.coordinates import CoordinateSearch
from train.searchers.named import METHODS, make_searcher, n_updates, runs_vary
from train.searchers.sampled import SAMPLED, SampledSearch

GRADIENTS = [name for name, method in METHODS.items() if method.gradient]


@pytest.fixture(scope="module")
def task():
    return Short()


def learner(task, name, **options):
    return Learner(options_for("via_point", runs=2, optimizer=name, updates=3, rollouts=5, **options), task)


@pytest.mark.slow
def test_a_name_makes_the_searcher_of_its_kind(task):
    policy = task.policy().expand(2)
    sampled = make_searcher(options_for("via_point", runs=2, optimizer="pi2cma", rollouts=6), task, policy)
    assert isinstance(sampled, SampledSearch) and isinstance(sampled.optim, PI2CMA)
    fixed = make_searcher(options_for("via_point", runs=2, optimizer="cma", rollouts=6), task, policy)
    assert isinstance(fixed, CoordinateSearch) and fixed.optim is None
    assert (sampled.n_rollouts, fixed.n_rollouts) == (6, 6)


@pytest.mark.parametrize(("name", "expected"), [("pibb", 11), ("adam", 11), ("finite_differences", 2)])
def test_the_budget_is_shared_out_among_steps_of_the_size_that_a_searcher_needs(task, name, expected):
    options = options_for(
        "via_point", optimizer=name, updates=11, rollouts=5
    )  # 55 roll-outs; P + 1 = 25 for a difference
    assert n_updates(options, task, make_searcher(options, task, task.policy().expand(1))) == expected


def test_every_name_of_the_option_is_one_optimizer():
    assert sorted(get_args(Optimizer)) == sorted([*SAMPLED, *METHODS])


@pytest.mark.parametrize(
    ("name", "vary"), [("adam", False), ("cobyqa", False), ("finite_differences", False), ("cma", True), ("pibb", True)]
)
def test_runs_vary_where_something_is_random(task, name, vary):
    class Going(Short):
        def state_dict(self):
            return {"trials": 0}

    assert runs_vary(options_for("via_point", optimizer=name), task) == vary
    assert runs_vary(options_for("via_point", optimizer=name, cost_noise=0.1), task)
    assert runs_vary(options_for("via_point", optimizer=name), Going())
    pushed, still = (tasks.make("half_plane_force", pushes=std) for std in (1.0, 0.0))
    assert runs_vary(options_for("half_plane_force", optimizer=name), pushed)
    assert runs_vary(options_for("half_plane_force", optimizer=name), still) == vary


@pytest.mark.parametrize("name", GRADIENTS)
@pytest.mark.slow
def test_gradients_are_refused_where_there_are_none(name):
    class Rigid(tasks.ViaPoint):
        differentiable = False

    with pytest.raises(
        InvalidArgumentError, match=f"--optimizer {name} needs the gradient of a trial.*without gradients: pibb"
    ):
        learner(Rigid(), name)


@pytest.mark.parametrize(("option", "value"), [("decay", "none"), ("temperature", "capped"), ("elite", "best")])
def test_options_of_sampled_noise_are_refused(task, option, value):
    with pytest.raises(InvalidArgumentError, match=f"--{option} {value} goes with --optimizer pibb"):
        learner(task, "adam", **{option: value})


def test_shrunk_noise_is_refused(task):
    with pytest.raises(InvalidArgumentError, match=r"cannot shrink noise; .*--shrink none"):
        learner(task, "cobyqa", exploration="stable")


@pytest.mark.parametrize("name", [name for name in get_args(Optimizer) if name != "finite_differences"])
@pytest.mark.slow
def test_every_optimizer_learns_a_primitive(name):
    """Along the motion where it is made for that; the cost falls within 60 roll-outs, for all but the score function."""
    chosen = {"exploration": "trajectory"} if name == "surrogate" else {}
    options = options_for("via_point", shape="P", system="dmp", optimizer=name, updates=6, rollouts=10, **chosen)
    cost = [row[0] for row in Learner(options).learn().history.cost]
    assert cost[-1] < (0.97 if name == "nes" else 0.9) * cost[0]
