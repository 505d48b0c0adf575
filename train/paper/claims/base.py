"""A claim of the paper, what was measured for it, and the rules that decide whether it held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from train.paper.measured.base import Setting
from train.paper.measured.via_points import SHAPES
from train.statistics import Values, below, delta, differ, summary

ALPHA = 0.01  # p of a test that shows something
MEDIUM = 0.33  # Cliff's delta from which an effect is a medium one (Romano et al. 2006)

HELD, IN_PART, NOT_HELD, NOT_MEASURED = "held", "held in part", "not held", "not measured here"


class Check(NamedTuple):
    """One measured statement.

    Attributes:
        what: the statement, with its numbers.
        holds: whether it does, by the rule of the function below that made it.
        n: size of the samples, or the number of cases counted.
        effect: Cliff's delta of a comparison, from −1 to 1; None for a number.
        p: of the test; None without one.
    """

    what: str
    holds: bool
    n: int
    effect: float | None = None
    p: float | None = None


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        id: its name for `--only`.
        where: section, figure or equation.
        says: what the paper says, in a sentence of our own.
        rule: what has to be measured for it to hold.
        measure: the checks; none where what they need is not there.
        simulated: whether it takes learning runs of its own, so that the result is worth keeping; else it reads files.
    """

    id: str
    where: str
    says: str
    rule: str
    measure: Callable[[Setting], list[Check]]
    simulated: bool = True


def verdict(checks: Sequence[Check]) -> str:
    """All checks hold, some, or none; or there are none."""
    if not checks:
        return NOT_MEASURED
    held = [check.holds for check in checks]
    return HELD if all(held) else IN_PART if any(held) else NOT_HELD


def each(measure: Callable[[str, Setting], list[Check]]) -> Callable[[Setting], list[Check]]:
    """The checks of both letters."""
    return lambda setting: [check for shape in SHAPES for check in measure(shape, setting)]


# ------------------------------------------------------------------ checks


def lower(what: str, a: Values, b: Values) -> Check:
    """Independent samples: `a` is lower than `b`, by a one-sided Mann-Whitney test and an effect that is at least medium."""
    p, effect = below(a, b), delta(a, b)
    gap = float(np.median(a) - np.median(b))
    text = f"{what}: {summary(a)} against {summary(b)}, difference of medians {gap:+.3g}"
    return Check(text, p < ALPHA and effect <= -MEDIUM, len(a), effect, p)


def changes(what: str, before: Values | float, after: Values, *, falls: bool = True) -> Check:
    """Pairs: `after` is lower than `before`, or higher, by a one-sided sign test and an effect that is at least medium.

    Args:
        what: is compared.
        before: a sample, or one number for all.
        after: a sample.
        falls: whether it should be lower.
    """
    import scipy.stats  # takes a second

    after = np.asarray(after, dtype=float)
    before = np.broadcast_to(np.asarray(before, dtype=float), after.shape)
    down, up = int((after < before).sum()), int((after > before).sum())
    wanted = down if falls else up
    p = float(scipy.stats.binomtest(wanted, down + up, alternative="greater").pvalue) if down + up else 1.0
    effect = (up - down) / len(after)
    way = f"{'falls' if falls else 'rises'} in {wanted} of {len(after)}"
    first = f"{before[0]:.3g}" if np.ptp(before) == 0 else summary(before)
    text = f"{what}: {first} → {summary(after)}, {way}"
    return Check(text, p < ALPHA and (-effect if falls else effect) >= MEDIUM, len(after), effect, p)


def alike(what: str, a: Values, b: Values) -> Check:
    """Independent samples: the effect is less than medium, and a two-sided Mann-Whitney test shows no difference."""
    p, effect = differ(a, b), delta(a, b)
    text = f"{what}: {summary(a)} against {summary(b)}"
    return Check(text, p > ALPHA and abs(effect) < MEDIUM, len(a), effect, p)


def counted(what: str, cases: int, n: int, share: float = 1.0) -> Check:
    """At least a share of `n` cases."""
    return Check(f"{what}: {cases} of {n}", cases >= share * n, n)


def within(what: str, values: Values | float, low: float = -np.inf, high: float = np.inf) -> Check:
    """A number, or the median of a sample, lies in [low, high]."""
    values = np.atleast_1d(np.asarray(values, dtype=float))
    bounds = f"≥ {low:g}" if high == np.inf else f"≤ {high:g}" if low == -np.inf else f"{low:g} to {high:g}"
    text = f"{values[0]:.3g}" if len(values) == 1 else summary(values)
    return Check(f"{what}: {text} (asked for: {bounds})", low <= float(np.median(values)) <= high, len(values))
