"""The half-plane force: Eq. 51 and the released program's costs in numpy, and what is learned.

A median of 20 runs moves from seed to seed, and the last digit of a linear algebra library makes another seed; 60 runs in a
batch take little longer and settle the comparisons on every machine.
"""

import functools

import numpy as np
import pytest
import scipy.stats
import torch

import tasks
from tasks.released.exploration import ReleasedHomogeneous
from tests.force_fields import synthetic_mixture
from torchds.errors import InvalidArgumentError
from train.learning.learner import Learner
from train.options import options_for

VIA = [(-9.0, 4.3), (-6.0, 4.0), (-3.6, 1.8), (-1.4, 0.4)]
RELEASED_VIA = [(-7.5, -1.0), (-5.0, 0.0), (-2.5, 1.0), (-1.25, 0.5)]
LIMITS = {"paper": ("implicit", 0.1, 1000.0), "released": ("explicit", 0.0, np.inf)}


def nothing(q):
    return np.zeros(2)


def upwards(q):
    return np.array([0.0, 10.0]) if q[0] > -5 else np.zeros(2)


@functools.cache
def make(convention="paper", **options):
    data = {"mixture": synthetic_mixture()} if convention == "released" else {}
    return tasks.make("half_plane_force", convention=convention, **data, **options)


# ------------------------------------------------------------------ the task


@pytest.mark.parametrize("convention", ["paper", "released"])
@pytest.mark.parametrize("stiffness", ["diagonal", "isotropic"])
@pytest.mark.slow
def test_cost_terms_are_those_of_a_loop_over_both_executions(convention, stiffness, tracked, vary):
    task = make(convention, stiffness=stiffness)
    policy = vary(task.policy(), 3, 0.02, stiffness=1.0)
    with torch.no_grad():
        path, terms = task.evaluate(policy)
    start, n_steps, points, r_control = {
        "paper": ((-12.0, 0.0), 150, VIA, 1e-6),
        "released": ((-10.0, 0.0), 120, RELEASED_VIA, 1e-7),
    }[convention]
    assert path.x.shape == (3, 2, n_steps + 1, 2)
    for r in range(3):
        parts = {name: [] for name in ("via_points", "goal", "acceleration", "stiffness")}
        for i, force in enumerate((nothing, upwards)):
            x, v, a, s = tracked(policy, r, start, n_steps, force, *LIMITS[convention])
            np.testing.assert_allclose(path.x[r, i], x, rtol=0, atol=1e-8)
            parts["via_points"].append(sum(min(((np.array(p) - q) ** 2).sum() for q in x[1:]) for p in points))
            parts["goal"].append((x[-1] ** 2).sum())
            if convention == "paper":
                parts["acceleration"].append(sum(np.linalg.norm(v[j + 1] - v[j]) for j in range(1, n_steps)))
                parts["stiffness"].append(sum(np.linalg.norm(s_j) for s_j in s))  # √2 s for an isotropic s
            else:
                parts["acceleration"].append(sum((a_j**2).sum() for a_j in a))
                parts["stiffness"].append(sum(s_j[0] + s_j[1] for s_j in s))  # an isotropic s counts twice
        expected = {name: np.mean(parts[name]) for name in ("via_points", "goal")}
        for name, weight in (("acceleration", 1e-3), ("stiffness", 2e-4)):
            # The released program halves the disturbed execution's and leaves the other one out.
            both = parts[name] if convention == "paper" else [0.0, parts[name][1]]
            expected[name] = weight * np.mean(both)
        deviation = (policy.pack()[r] - task.policy().pack()).detach().numpy()
        expected["control"] = n_steps * 0.5 * r_control * (deviation**2).sum()
        assert set(terms) == set(expected)
        for name, value in expected.items():
            assert terms[name][r].item() == pytest.approx(value, rel=1e-7), name


@pytest.mark.parametrize("convention", ["paper", "released"])
@pytest.mark.slow
def test_the_force_is_there_in_the_second_execution_where_the_mass_is_beyond_the_border(convention):
    task = make(convention, initial_stiffness=3.0)
    with torch.no_grad():
        path = task.rollout(task.policy())
    force, x = path.plant.force, path.plant.x
    assert not force[0].any()
    for t in range(x.shape[-2] - 1):
        assert force[1, t + 1].tolist() == upwards(x[1, t].numpy()).tolist()
    beyond = {name: value[1, :-1, 0] > -5 for name, value in (("mass", x), ("reference", path.reference))}
    assert (beyond["mass"] != beyond["reference"]).any()  # it is not the reference that decides
    assert torch.equal(path.reference[0], path.reference[1])
    border = torch.tensor([[-5.0, 0.0], [-5.0, 0.0]], dtype=torch.float64)
    assert not task.force()(0.0, border, border).any()


@pytest.mark.slow
def test_the_imitated_motion_passes_near_the_via_points_unless_the_force_is_there():
    task = make()
    assert task.policy().n_components == 4
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    free, pushed = (
        sum(((path.x[i, 1:] - torch.tensor(p)).norm(dim=-1).min() ** 2).item() for p in VIA) for i in (0, 1)
    )
    assert terms["via_points"].item() == pytest.approx((free + pushed) / 2)
    assert pushed > 3 * free
    assert terms["stiffness"].item() == pytest.approx(2e-4 * 150 * 10 * 2**0.5)


@pytest.mark.slow
def test_isotropic_stiffness_has_one_row_and_costs_as_two_equal_ones():
    for convention in ("paper", "released"):
        diagonal, isotropic = make(convention), make(convention, stiffness="isotropic")
        assert (diagonal.policy().stiffness_dim, isotropic.policy().stiffness_dim) == (2, 1)
        with torch.no_grad():
            terms = [task.evaluate(task.policy())[1] for task in (diagonal, isotropic)]
        for name, value in terms[0].items():
            torch.testing.assert_close(terms[1][name], value, rtol=1e-10, atol=0)


def test_the_settings_are_those_of_the_paper_and_of_the_released_program():
    paper, released = make().search, make("released").search
    assert [(s.n_updates, s.n_rollouts) for s in (paper, released)] == [(100, 10)] * 2
    # A search adds the control cost of both executions, so half of r = 1e-6 and of the released 1e-7 are their means.
    assert (paper.control_weight, released.control_weight) == (0.5e-6, 0.5e-7)
    assert (released.homogeneous, released.temperature, released.decay) == (ReleasedHomogeneous, "median", "linear")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stiffness": "full"}, "stiffness has to be 'diagonal' or 'isotropic', got 'full'"),
        ({"convention": "draft"}, "convention of task 'half_plane_force' has to be 'paper' or 'released', got 'draft'"),
    ],
)
def test_unknown_kinds_are_refused(options, message):
    with pytest.raises(InvalidArgumentError, match=message):
        tasks.make("half_plane_force", **options)


# ------------------------------------------------------------------ what is learned

RUNS = 60


@functools.cache
def learned():
    return Learner(options_for("half_plane_force", runs=RUNS)).learn()


def final_cost(n_updates, **options):
    """After so many of the task's updates, without looking at the policies in between."""
    learner = Learner(options_for("half_plane_force", runs=RUNS, **options))
    for _ in range(n_updates):
        learner.searcher.step(learner.closure)
    return tasks.base.total(learner.evaluate().values()).numpy()


@pytest.mark.slow
def test_a_stiffness_of_each_axis_ends_below_the_same_for_both():
    """Fig. 14, right."""
    assert learned().history.rollouts[-1] == 1000
    diagonal, isotropic = np.array(learned().history.cost[-1]), final_cost(100, stiffness="isotropic")
    assert np.median(diagonal) < np.median(isotropic)
    assert scipy.stats.mannwhitneyu(diagonal, isotropic, alternative="less").pvalue < 0.01


def test_the_second_axis_gets_stiff_where_the_force_may_be_and_the_rest_gets_soft():
    """Fig. 13; the stiffness begins at 10 N/m."""
    path = learned().path
    s, there = path.plant.stiffness[..., 1:, :].numpy(), path.plant.x[..., :-1, 0].numpy() > -5
    first, second = ([s[..., d][there].mean(), s[..., d][~there].mean()] for d in (0, 1))
    assert second[0] > 1.5 * second[1]
    assert second[0] > 10 > second[1]
    assert max(first) < 10
    assert s[..., 0].mean((1, 2)).max() < 10  # in every run


def test_the_stiffness_cost_first_rises_and_then_falls():
    """Fig. 14, left: the mean curve."""
    curve = np.mean(learned().history.terms["stiffness"], axis=1)
    peak = curve.argmax()
    assert 1 <= peak <= 30
    assert curve[peak] > 1.05 * curve[0]
    assert curve[-1] < 0.9 * curve[peak]


@pytest.mark.slow
def test_the_recommended_learner_needs_400_rollouts_for_what_takes_the_paper_1000():
    recommended = {"exploration": "trajectory", "optimizer": "surrogate"}
    along, history = np.median(final_cost(40, **recommended)), learned().history
    assert (history.rollouts[40], history.rollouts[100]) == (400, 1000)
    assert along <= np.median(history.cost[100])
    assert along < 0.98 * np.median(history.cost[40])
