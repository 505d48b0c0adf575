"""The divergent field: Eq. 49-50 and the released program's costs in numpy, and what 20 runs learn."""

import functools

import numpy as np
import pytest
import scipy.stats
import torch

import tasks
from tasks.released.exploration import ReleasedHomogeneous
from tests.force_fields import synthetic
from torchds.exploration import Homogeneous
from train.learning.learner import Learner
from train.options import options_for

VIA = [(-9.0, 4.3), (-6.0, 4.0), (-3.6, 1.8), (-1.4, 0.4)]
RELEASED_VIA = [(-7.5, -1.0), (-5.0, 0.0), (-2.5, 1.0), (-2.5, 1.0), (-1.25, 0.5)]
LIMITS = {"paper": ("implicit", 0.1, 1000.0), "released": ("explicit", 0.0, np.inf)}


def arch(n=400):
    s = np.arange(n) / (n - 1)
    return np.stack([-12 * (1 - s), 4 * np.sin(np.pi * s) + 1.5 * np.sin(2 * np.pi * s)], -1)


def sine():
    return np.array([(-10 * (1 - c / 100), np.sin(2 * np.pi * (1 - c / 100))) for c in range(1, 101)])


def nearest(q, path):
    return min(range(len(path)), key=lambda i: np.linalg.norm(q - path[i]))


def radial(q):
    path = arch()
    return 10 * (q - path[nearest(q, path)])


def normal(q):
    """Along the normal of the segment at the nearest point, to the side where q is."""
    path = sine()
    i = nearest(q, path)
    tangent = path[min(i, 98) + 1] - path[min(i, 98)]
    across = np.array([-tangent[1], tangent[0]]) / np.hypot(*tangent)
    return 10 * np.linalg.norm(q - path[i]) * np.sign(across @ (q - path[i])) * across


@functools.cache
def make(convention, **options):
    data = {"demonstrations": synthetic()} if convention == "released" else {}
    return tasks.make("divergent_field", convention=convention, **data, **options)


# ------------------------------------------------------------------ the task


@pytest.mark.parametrize(("convention", "expected"), [("paper", radial), ("released", normal)])
@pytest.mark.slow
def test_the_force_is_ten_times_the_distance_away_from_the_path(convention, expected):
    x = torch.tensor([-6.0, 1.5]).double() + 4 * torch.randn(
        3, 40, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    task = make(convention)
    force = task.force()(0.0, x, torch.zeros_like(x))
    for i in np.ndindex(3, 40):
        np.testing.assert_allclose(force[i], expected(x[i].numpy()), rtol=0, atol=1e-10)
    on_path = task.nominal()
    assert not task.force()(0.0, on_path, torch.zeros_like(on_path)).any()


@pytest.mark.slow
@pytest.mark.parametrize("convention", ["paper", "released"])
@pytest.mark.parametrize("stiffness", ["diagonal", "isotropic"])
def test_cost_terms_are_those_of_a_loop(convention, stiffness, tracked, vary):
    task = make(convention, stiffness=stiffness)
    policy = vary(task.policy(), 3, 0.02, stiffness=1.0)
    with torch.no_grad():
        path, terms = task.evaluate(policy)
    start, n_steps, force, points = {
        "paper": ((-11.7, -0.3), 150, radial, VIA),
        "released": ((-10.0, 0.2), 120, normal, RELEASED_VIA),
    }[convention]
    for r in range(3):
        x, v, a, s = tracked(policy, r, start, n_steps, force, *LIMITS[convention])
        np.testing.assert_allclose(path.x[r], x, rtol=0, atol=1e-8)
        expected = {
            "via_points": sum(min(((np.array(p) - q) ** 2).sum() for q in x[1:]) for p in points),
            "goal": (x[-1] ** 2).sum(),
            "control": n_steps * 0.5 * 1e-6 * ((policy.pack()[r] - task.policy().pack()) ** 2).sum().item(),
        }
        if convention == "paper":
            expected["acceleration"] = 1e-4 * sum(np.linalg.norm(v[j + 1] - v[j]) for j in range(1, n_steps))
            expected["stiffness"] = 5e-4 * sum(np.linalg.norm(s_j) for s_j in s)
        else:
            expected["acceleration"] = 1e-4 * sum((a_j**2).sum() for a_j in a)
            expected["stiffness"] = 5e-4 * sum(s_j[0] + s_j[1] for s_j in s)
        assert set(terms) == set(expected)
        for name, value in expected.items():
            assert terms[name][r].item() == pytest.approx(value, rel=1e-7), name


@pytest.mark.slow
@pytest.mark.parametrize("convention", ["paper", "released"])
def test_stiffness_is_cut_at_the_bounds_and_costs_as_applied(convention, tracked):
    task = make(convention)
    policy = task.policy()
    with torch.no_grad():
        policy.stiffness_A.add_(torch.tensor([[30.0, 0.0], [300.0, 0.0]]))
        policy.stiffness_b.add_(torch.tensor([150.0, 1800.0]))
        path, terms = task.evaluate(policy)
        shown = task.diagnostics(path)
    applied = path.plant.stiffness[1:].numpy()
    _, low, high = LIMITS[convention]
    assert applied.min() == low
    assert applied.max() == (high if convention == "paper" else path.stiffness.max())
    norms = np.linalg.norm(applied, axis=1) if convention == "paper" else applied.sum(1)
    assert terms["stiffness"].item() == pytest.approx(5e-4 * norms.sum(), rel=1e-12)
    asked = path.stiffness.numpy()
    assert shown["stiffness/clamped"].item() == pytest.approx(np.mean((asked < low) | (asked > high)))
    assert shown["stiffness/mean"].item() == pytest.approx(applied.mean())
    assert shown["stiffness/injected_energy"] > 0


def test_the_imitated_motion_misses_the_via_points_at_a_constant_stiffness():
    task = make("paper")
    policy = task.policy()
    assert (policy.n_components, policy.stiffness_dim) == (4, 2)
    with torch.no_grad():
        path, terms = task.evaluate(policy)
        away = task.force()(0.0, path.x, path.x).norm(dim=-1) / 10
    assert path.plant.stiffness.shape == (151, 2)
    torch.testing.assert_close(path.plant.stiffness[1:], 0 * path.plant.stiffness[1:] + 20, rtol=1e-12, atol=0)
    assert terms["stiffness"].item() == pytest.approx(5e-4 * 150 * 20 * 2**0.5)
    assert terms["control"] == 0
    assert terms["via_points"] > 0.5
    assert away.max() > 0.5
    shown = task.diagnostics(path)
    assert shown["stiffness/clamped"] == 0
    assert shown["stiffness/injected_energy"] < 1e-12


def test_the_settings_are_those_of_the_paper_and_of_the_released_program():
    paper, released = make("paper").search, make("released").search
    for search in (paper, released):
        assert (search.n_updates, search.n_rollouts, search.control_weight, search.elite) == (100, 10, 1e-6, "none")
    assert (paper.homogeneous, paper.temperature, paper.decay) == (Homogeneous, "range", "inverse")
    assert (released.homogeneous, released.temperature, released.decay) == (ReleasedHomogeneous, "median", "linear")
    assert make("released").policy().n_components == 3


# ------------------------------------------------------------------ what is learned

RUNS = 20


@functools.cache
def learned(n_updates=100, **options):
    """The learner, and its cost terms `(RUNS,)` before and after so many of the task's updates."""
    learner = Learner(options_for("divergent_field", runs=RUNS, **options))
    before = learner.evaluate()
    for _ in range(n_updates):
        learner.searcher.step(learner.closure)
    return learner, before, learner.evaluate()


def final(n_updates=100, **options):
    return tasks.base.total(learned(n_updates, **options)[2].values()).numpy()


@pytest.mark.slow
def test_via_points_are_reached_at_a_lower_stiffness_in_every_run():
    """Figs 10 and 11: 100 updates of ten roll-outs."""
    _, before, after = learned()
    assert after["via_points"].median() < 0.1 * before["via_points"].median()
    assert after["stiffness"].median() < 0.9 * before["stiffness"].median()
    assert (final() < tasks.base.total(before.values()).numpy()).all()


@pytest.mark.slow
@pytest.mark.parametrize("alone", ["motion", "stiffness"])
def test_motion_and_stiffness_together_are_better_than_either_alone(alone):
    learner, _, _ = learned(learn=alone)
    for name in {"motion": ("stiffness_A", "stiffness_b"), "stiffness": ("A", "b")}[alone]:
        initial, now = learner.initial.get_parameter(name), learner.policy.get_parameter(name)
        assert torch.equal(now, initial.expand_as(now))
    assert scipy.stats.mannwhitneyu(final(), final(learn=alone), alternative="less").pvalue < 0.01


@pytest.mark.slow
def test_the_recommended_learner_needs_400_rollouts_for_what_takes_the_paper_1000():
    recommended = {"exploration": "trajectory", "optimizer": "surrogate"}
    assert np.median(final(40, **recommended)) <= np.median(final())
