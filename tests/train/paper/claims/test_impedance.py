"""The claims of section 5 hold for made-up learners that agree with them, and fail for those that do not."""

from types import SimpleNamespace

import numpy as np
import pytest

from torchds.plants import PointMass
from train.paper.claims import impedance
from train.paper.claims.base import HELD, NOT_HELD, verdict
from train.paper.measured.base import Setting

SETTING = Setting(20, 0, None)
T = np.linspace(0, 1, 41)[:, None]
JITTER = 1 + 0.01 * np.linspace(-1, 1, 20)


def curves(**terms):
    """A finished learner whose 20 runs have these courses, a little apart."""
    courses = {name: course * JITTER for name, course in terms.items()}
    return SimpleNamespace(history=SimpleNamespace(cost=sum(courses.values()), terms=courses))


@pytest.mark.parametrize(("fall", "expected"), [(0.5, [True, True]), (-0.5, [False, True])])
def test_both_costs_have_to_fall(fall, expected, monkeypatch):
    learner = curves(stiffness=1 - fall * T, via_points=np.exp(-T))
    monkeypatch.setattr(impedance, "divergent", lambda runs, seed: learner)
    assert [check.holds for check in impedance.falls_of_both(SETTING)] == expected


@pytest.mark.parametrize(
    ("motion", "stiffness", "expected"), [(2.0, 3.0, [1, 1]), (0.5, 3.0, [0, 1]), (1.0, 1.0, [0, 0])]
)
def test_learning_both_has_to_end_below_either_alone(motion, stiffness, expected, monkeypatch):
    alone = {"motion": motion, "stiffness": stiffness}

    def divergent(runs, seed, learn=None):
        return curves(total=np.full_like(T, alone.get(learn, 1.0)))

    monkeypatch.setattr(impedance, "divergent", divergent)
    assert [check.holds for check in impedance.together(SETTING)] == expected


def bump(height):
    """A cost that first rises to a height, then falls to one half."""
    return np.interp(T, [0, 0.1, 1], [1, height, 0.5])


@pytest.mark.parametrize(
    ("stiffness", "rate", "expected"),
    [
        (bump(2.0), 5.0, [True, True, True]),
        (bump(0.9), 5.0, [False, True, True]),
        (bump(2.0), 0.01, [True, True, False]),
    ],
)
def test_the_stiffness_cost_rises_first_and_falls_then(stiffness, rate, expected, monkeypatch):
    learner = curves(stiffness=stiffness, via_points=np.exp(-rate * T))
    monkeypatch.setattr(impedance, "half_plane", lambda runs, seed: learner)
    assert [check.holds for check in impedance.two_phases(SETTING)] == expected


@pytest.mark.parametrize(("isotropic", "expected"), [(2.0, HELD), (1.0, NOT_HELD)])
def test_diagonal_stiffness_has_to_end_below_isotropic(isotropic, expected, monkeypatch):
    final = {"diagonal": 1.0, "isotropic": isotropic}
    monkeypatch.setattr(impedance, "half_plane", lambda runs, seed, kind: curves(total=np.full_like(T, final[kind])))
    assert verdict(impedance.diagonal(SETTING)) == expected


@pytest.mark.slow
def test_the_controller_as_printed_is_critically_damped_and_the_disturbance_is_there_before_learning():
    for damped in impedance.damping(SETTING):
        assert damped.holds and damped.n == 41 and "41 of 41" in damped.what
    assert verdict(impedance.disturbed(SETTING)) == HELD
    assert verdict(impedance.missed(SETTING)) == HELD


@pytest.mark.slow
def test_more_damping_than_critical_settles_too_late(monkeypatch):
    monkeypatch.setattr(impedance, "PointMass", lambda mass, damping: PointMass(mass, damping=0.5))
    assert [check.holds for check in impedance.damping(SETTING)] == [True, False]
