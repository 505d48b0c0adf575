"""The claims of section 3 hold for made-up learning curves that agree with them, and fail for those that do not."""

from types import SimpleNamespace

import numpy as np
import pytest

from train.paper.claims import via_points
from train.paper.claims.base import HELD, NOT_HELD, verdict
from train.paper.measured.base import Setting

SETTING = Setting(20, 0, None)
T = np.linspace(0, 1, 41)[:, None]
JITTER = 1 + 0.01 * np.linspace(-1, 1, 20)


def curves(**terms):
    """A finished learner whose 20 runs have these courses, a little apart."""
    courses = {name: course * JITTER for name, course in terms.items()}
    total = sum(courses.values())
    return SimpleNamespace(history=SimpleNamespace(cost=total, terms=courses))


@pytest.fixture
def learns(monkeypatch):
    """Lets the letters be learned as a function of their options says."""

    def as_(learner, **options):
        found = lambda shape, runs, seed, **chosen: options[chosen["optimizer"]] if chosen else learner  # noqa: E731
        monkeypatch.setattr(via_points, "letter", found)

    return as_


@pytest.mark.parametrize(("rate", "expected"), [(5.0, HELD), (0.01, NOT_HELD)])
def test_a_decay_falls_fast_and_a_line_does_not(rate, expected, learns):
    learns(curves(via_points=3 * np.exp(-rate * T)))
    assert verdict(via_points.fast_fall("N", SETTING)) == expected


@pytest.mark.parametrize(("rise", "expected"), [(0.2, [True, True]), (-0.2, [False, True]), (9.0, [True, False])])
def test_the_acceleration_rises_slowly(rise, expected, learns):
    learns(curves(via_points=3 * np.exp(-5 * T), acceleration=1 + rise * T))
    assert [check.holds for check in via_points.acceleration("N", SETTING)] == expected


@pytest.mark.parametrize(("share", "expected"), [(0.05, NOT_HELD), (0.3, HELD)])
def test_the_trade_off_is_a_tenth_of_the_final_cost(share, expected, learns):
    learns(curves(via_points=(1 - share) * np.ones_like(T), acceleration=share * np.ones_like(T)))
    assert verdict(via_points.trade_off("N", SETTING)) == expected


@pytest.mark.parametrize(
    ("control", "without", "expected"),
    [(0.01, 1.0, [True, True]), (0.9, 1.0, [False, True]), (0.01, 1.5, [True, False])],
)
def test_the_control_cost_is_small_and_changes_nothing_else(control, without, expected, learns, monkeypatch):
    def letter(level, control):
        ones = np.ones_like(T)
        return curves(via_points=level * ones, goal=0.1 * ones, acceleration=0.2 * ones, control=control * ones)

    learns(letter(1.0, control))
    monkeypatch.setattr(via_points, "uncontrolled", lambda shape, runs, seed: letter(without, 0.0))
    assert [check.holds for check in via_points.control("P", SETTING)] == expected


@pytest.mark.parametrize(("theirs", "expected"), [(2.0, HELD), (1.0, NOT_HELD), (0.5, NOT_HELD)])
def test_pibb_has_to_end_below_pi2(theirs, expected, learns):
    learns(curves(via_points=np.ones_like(T)), pi2=curves(via_points=theirs * np.ones_like(T)))
    assert verdict(via_points.pi2("N", SETTING)) == expected
