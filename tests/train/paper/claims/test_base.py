"""The rules that decide whether a claim holds: each against what it has to count."""

import itertools

import numpy as np
import pytest

from train.paper.claims import base
from train.paper.claims.base import HELD, IN_PART, NOT_HELD, NOT_MEASURED, Check, each, verdict
from train.paper.measured.base import Setting


@pytest.mark.parametrize(
    ("held", "expected"),
    [([], NOT_MEASURED), ([1], HELD), ([1, 1, 1], HELD), ([1, 0], IN_PART), ([0, 0, 1], IN_PART), ([0, 0], NOT_HELD)],
)
def test_the_verdict(held, expected):
    assert verdict([Check("", bool(h), 1) for h in held]) == expected


def test_lower_has_the_p_of_all_permutations(randn):
    a, b = randn(5).numpy(), randn(5).numpy() + 1.0
    pooled = np.concatenate([a, b])

    def wins(chosen):
        rest = [i for i in range(10) if i not in chosen]
        return sum(pooled[i] > pooled[j] for i in chosen for j in rest)

    splits = [wins(chosen) for chosen in itertools.combinations(range(10), 5)]
    check = base.lower("x", a, b)
    assert check.p == pytest.approx(np.mean([w <= wins(range(5)) for w in splits]), rel=1e-9)
    assert check.n == 5


@pytest.mark.slow
def test_lower_needs_a_test_and_an_effect(randn):
    small, large = randn(2000).numpy(), randn(2000).numpy()
    trifling = base.lower("x", small, large + 0.2)
    assert trifling.p < 1e-4 and not trifling.holds
    few = base.lower("x", [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    assert few.effect == -1.0 and not few.holds
    assert base.lower("x", small[:20], small[:20] + 2).holds
    assert not base.lower("x", small[:20] + 2, small[:20]).holds


@pytest.mark.parametrize("falls", [True, False])
def test_changes_is_a_sign_test(falls):
    before, sign = np.arange(12.0), -1 if falls else 1
    after = before + sign * 0.5
    check = base.changes("x", before, after, falls=falls)
    assert check.holds and check.p == pytest.approx(0.5**12) and check.effect == sign
    assert not base.changes("x", before, after, falls=not falls).holds
    after[:3] = before[:3]  # ties say nothing
    assert base.changes("x", before, after, falls=falls).p == pytest.approx(0.5**9)
    assert base.changes("x", 3.0, np.full(5, 3.0), falls=falls).p == 1.0
    assert "x: 3 → 3" in base.changes("x", 3.0, np.full(5, 3.0), falls=falls).what
    assert not base.changes("x", before[:6], before[:6] + sign, falls=falls).holds  # 1/64 > 0.01


def test_alike_holds_for_one_distribution_and_not_for_two(randn):
    a = randn(40).numpy()
    assert base.alike("x", a, a + 0.01).holds
    assert not base.alike("x", a, a + 2).holds
    assert not base.alike("x", a + 2, a).holds


def test_numbers_hold_within_their_bounds_and_counts_from_their_share():
    assert [base.within("x", v, 1.0, 2.0).holds for v in (0.9, 1.0, 1.5, 2.1, np.nan)] == [0, 1, 1, 0, 0]
    assert base.within("x", [0.0, 1.5, 9.0], 1.0, 2.0).holds  # the median
    assert [base.counted("x", k, 20, 0.9).holds for k in (17, 18, 20)] == [0, 1, 1]
    assert [base.counted("x", k, 20).holds for k in (19, 20)] == [0, 1]


def test_the_checks_of_both_letters_stand_one_after_the_other():
    setting = Setting(3, 0, None)
    measure = each(lambda shape, asked: [Check(shape, asked is setting, 1)])
    assert measure(setting) == [Check("N", True, 1), Check("P", True, 1)]
