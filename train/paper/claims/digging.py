"""The claims of section 6: shoveling gravel (Figs 16 and 17), from a digging experiment that is there.

Of uniform stiffness each trial is a sample, of learned policies each learning run, by the mean of its trials.
"""

from __future__ import annotations

import numpy as np

from train.paper.claims.base import Check, Claim, lower, within
from train.paper.measured.base import Setting
from train.paper.measured.digging import PAPER, UNIFORM, best_uniform, history, means, trials
from train.statistics import deviation

SOFT, STIFF = 150.0, 400.0  # N/m
BEST = (200.0, 350.0)  # N/m
SAME = 1.25  # factor up to which forces "do not really increase"
ENOUGH = 5  # runs: fewer cannot show p < 0.01 against as many


# ------------------------------------------------------------------ uniform stiffness


def soft_loads_less(setting: Setting) -> list[Check]:
    """Loads with a soft and with a stiff uniform stiffness."""
    recorded = setting.experiment.recorded()
    soft, stiff = (trials(recorded, f"uniform-{s:g}") for s in (SOFT, STIFF))
    if not soft or not stiff:
        return []
    return [lower("load [N], 150 N/m below 400 N/m", soft["gravel/load"], stiff["gravel/load"])]


def soft_is_gentle(setting: Setting) -> list[Check]:
    """Forces and force costs with a soft and with a stiff uniform stiffness."""
    recorded = setting.experiment.recorded()
    soft, stiff = (trials(recorded, f"uniform-{s:g}") for s in (SOFT, STIFF))
    if not soft or not stiff:
        return []
    return [
        lower("force cost, 150 N/m below 400 N/m", soft["force"], stiff["force"]),
        lower("peak force [N], 150 N/m below 400 N/m", soft["force/peak"], stiff["force/peak"]),
    ]


def best_between(setting: Setting) -> list[Check]:
    """The uniform stiffness that has the lowest mean cost."""
    recorded = setting.experiment.recorded()
    if not all(trials(recorded, f"uniform-{s:g}") for s in UNIFORM):
        return []
    low, high = BEST
    costs = {s: trials(recorded, f"uniform-{s:g}")["total"] for s in UNIFORM}
    best = float(best_uniform(recorded).removeprefix("uniform-"))
    between = min((s for s in UNIFORM if low <= s <= high), key=lambda s: costs[s].mean())
    cost, other = (f"{costs[s].mean():.2f} ± {deviation(costs[s]):.2f}" for s in (best, between))
    what = f"uniform stiffness with the lowest mean cost, {cost}, where the lowest from {low:g} to {high:g} is {other} [N/m]"
    return [within(what, best, low, high)]


# ------------------------------------------------------------------ learned policies


def samples(setting: Setting, start: float, term: str) -> tuple[np.ndarray, np.ndarray] | None:
    """A figure before and after learning, the means of groups of trials; None where there are too few runs."""
    recorded = setting.experiment.recorded()
    before, after = means(recorded, f"uniform-{start:g}"), means(recorded, f"{PAPER}-{start:g}")
    if not before or not after or min(len(before[term]), len(after[term])) < ENOUGH:
        return None
    return before[term], after[term]


def rises(setting: Setting, start: float, term: str, what: str) -> list[Check]:
    """A figure is higher after learning."""
    found = samples(setting, start, term)
    return [] if found is None else [lower(f"{what}, before below after learning", *found)]


def falls(setting: Setting, start: float, term: str, what: str) -> list[Check]:
    """A figure is lower after learning."""
    found = samples(setting, start, term)
    return [] if found is None else [lower(f"{what}, after below before learning", *found[::-1])]


def same_force(setting: Setting) -> list[Check]:
    """Force costs after learning over those before, on the same beds."""
    found = samples(setting, SOFT, "force")
    if found is None:
        return []
    before, after = found
    n = min(len(before), len(after))
    return [within("force cost after over before learning", after[:n] / before[:n], high=SAME)]


def dip_and_recovery(setting: Setting) -> list[Check]:
    """Means of the gravel's term, lower for more gravel, over the two halves of learning."""
    curves = history(setting.experiment, PAPER, STIFF)
    if curves is None or len(curves.cost[0]) < ENOUGH:
        return []
    gravel = np.array(curves.terms["gravel"])
    half = (len(gravel) + 1) // 2
    first, second = gravel[1:half].mean(0), gravel[half:].mean(0)
    return [
        lower("gravel term, at first below the mean of the first half", gravel[0], first),
        lower("mean of the second half below that of the first", second, first),
    ]


def below_uniform(setting: Setting) -> list[Check]:
    """Costs of what was learned against those of the best uniform stiffness, hence of all of them."""
    recorded = setting.experiment.recorded()
    learned = {start: means(recorded, f"{PAPER}-{start:g}") for start in (SOFT, STIFF)}
    if not all(trials(recorded, f"uniform-{s:g}") for s in UNIFORM) or not all(learned.values()):
        return []
    best = best_uniform(recorded)
    lowest = means(recorded, best)["total"]
    if min(len(lowest), *(len(sample["total"]) for sample in learned.values())) < ENOUGH:
        return []
    return [
        lower(
            f"cost, learned from {start:g} N/m below the best uniform one, {best.removeprefix('uniform-')}",
            sample["total"],
            lowest,
        )
        for start, sample in learned.items()
    ]


CLAIMS = tuple(
    Claim(id, where, says, rule, measure, simulated=False)
    for id, where, says, rule, measure in (
        (
            "digging-soft-load",
            "6, Fig. 16",
            "A low stiffness penetrates badly: it loads less gravel than a high one.",
            "Less load at 150 than at 400 N/m, both uniform.",
            soft_loads_less,
        ),
        (
            "digging-soft-force",
            "6, Fig. 16",
            "A low stiffness means small interaction forces, a high one large ones.",
            "Lower force cost and peak force at 150 than at 400 N/m, both uniform.",
            soft_is_gentle,
        ),
        (
            "digging-soft-stiffens",
            "6, Fig. 16 left",
            "From 150 N/m the mean stiffness increases.",
            "It is higher after learning.",
            lambda setting: rises(setting, SOFT, "stiffness/mean", "mean stiffness [N/m]"),
        ),
        (
            "digging-soft-gravel",
            "6, Fig. 16 left",
            "From 150 N/m more gravel is shoveled after learning.",
            "More load than before.",
            lambda setting: rises(setting, SOFT, "gravel/load", "load [N]"),
        ),
        (
            "digging-soft-same-force",
            "6, Fig. 16 left",
            "From 150 N/m the forces do not really increase.",
            f"The median over runs of the force cost after learning is at most {SAME:g} times that before.",
            same_force,
        ),
        (
            "digging-stiff-softens",
            "6, Fig. 16 right",
            "From 400 N/m the mean stiffness decreases.",
            "It is lower after learning.",
            lambda setting: falls(setting, STIFF, "stiffness/mean", "mean stiffness [N/m]"),
        ),
        (
            "digging-stiff-force",
            "6, Fig. 16 right",
            "From 400 N/m the forces decrease.",
            "The force cost is lower after learning.",
            lambda setting: falls(setting, STIFF, "force", "force cost"),
        ),
        (
            "digging-stiff-gravel",
            "6, Fig. 16 right",
            "From 400 N/m the gravel first decreases, and improves again in the second half of learning.",
            "Means of the gravel's term over the halves of the learning curves.",
            dip_and_recovery,
        ),
        (
            "digging-below-uniform",
            "6, Fig. 17",
            "Learned policies cost less than every uniform stiffness.",
            "From either start, lower than the best of them; a run counts with its mean of five trials on beds it has not met.",
            below_uniform,
        ),
        (
            "digging-best-uniform",
            "6, Fig. 17",
            "Among uniform stiffnesses the lowest cost is between 200 and 350 N/m.",
            "The one with the lowest mean cost over all trials.",
            best_between,
        ),
    )
)
