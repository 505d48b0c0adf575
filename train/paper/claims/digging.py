"""The claims of section 6: shoveling gravel (Figs 16 and 17), from a digging experiment that is there."""

from __future__ import annotations

import numpy as np

from train.paper.claims.base import Check, Claim, lower, within
from train.paper.measured.base import Setting
from train.paper.measured.digging import PAPER, UNIFORM, best_uniform, curves, learned_trials, uniform_trials

SOFT, STIFF = 150.0, 400.0  # N/m
BEST = (200.0, 350.0)  # N/m
SAME = 1.25  # factor up to which forces "do not really increase"


# ------------------------------------------------------------------ uniform stiffness


def soft_loads_less(setting: Setting) -> list[Check]:
    """Loads with a soft and with a stiff uniform stiffness."""
    soft, stiff = (uniform_trials(setting.experiment, s) for s in (SOFT, STIFF))
    if soft is None or stiff is None:
        return []
    return [lower("load [N], 150 N/m below 400 N/m", soft["gravel/load"], stiff["gravel/load"])]


def soft_is_gentle(setting: Setting) -> list[Check]:
    """Forces and force costs with a soft and with a stiff uniform stiffness."""
    soft, stiff = (uniform_trials(setting.experiment, s) for s in (SOFT, STIFF))
    if soft is None or stiff is None:
        return []
    return [
        lower("force cost, 150 N/m below 400 N/m", soft["force"], stiff["force"]),
        lower("peak force [N], 150 N/m below 400 N/m", soft["force/peak"], stiff["force/peak"]),
    ]


def best_between(setting: Setting) -> list[Check]:
    """The uniform stiffness that has the lowest mean cost."""
    trials = setting.experiment.recorded()
    if any(f"uniform-{s:g}" not in trials for s in UNIFORM):
        return []
    low, high = BEST
    best = best_uniform(trials)
    between = best_uniform({f"uniform-{s:g}": trials[f"uniform-{s:g}"] for s in UNIFORM if low <= s <= high})
    cost, other = (
        f"{np.mean(trials[name]['total']):.2f} ± {np.std(trials[name]['total'], ddof=1):.2f}"
        for name in (best, between)
    )
    what = f"uniform stiffness with the lowest mean cost, {cost}, where the lowest from {low:g} to {high:g} is {other} [N/m]"
    return [within(what, float(best.removeprefix("uniform-")), low, high)]


# ------------------------------------------------------------------ learned policies


def compared(
    setting: Setting, start: float, term: str, what: str, low: float = -np.inf, high: float = np.inf
) -> list[Check]:
    """The mean of a figure over trials after learning, over that before it; one learning run, so there is no test of it."""
    before, after = uniform_trials(setting.experiment, start), learned_trials(setting.experiment, start)
    if before is None or after is None:
        return []
    a, b = float(np.mean(before[term])), float(np.mean(after[term]))
    return [within(f"{what}, mean of {len(after[term])} trials, {a:.3g} → {b:.3g}, ratio", b / a, low, high)]


def soft_learns_gravel(setting: Setting) -> list[Check]:
    """Loads before and after learning from a soft stiffness."""
    before, after = uniform_trials(setting.experiment, SOFT), learned_trials(setting.experiment, SOFT)
    if before is None or after is None:
        return []
    return [lower("load [N], before below after learning", before["gravel/load"], after["gravel/load"])]


def dip_and_recovery(setting: Setting) -> list[Check]:
    """Means of the gravel's term, lower for more gravel, over the two halves of learning."""
    terms = curves(setting.experiment, STIFF)
    if terms is None:
        return []
    gravel = terms["gravel"]
    half = (len(gravel) + 1) // 2
    first, second = gravel[1:half].mean(), gravel[half:].mean()
    return [
        within(
            f"gravel term, {gravel[0]:.2f} at first, mean of the first half {first:.2f}, rise",
            first - gravel[0],
            low=0.0,
        ),
        within(f"mean of the second half {second:.2f}, fall against the first", first - second, low=0.0),
    ]


def below_uniform(setting: Setting) -> list[Check]:
    """Costs of what was learned against those of the best uniform stiffness, hence of all of them."""
    trials = setting.experiment.recorded()
    names = {start: f"{PAPER}-{start:g}" for start in (SOFT, STIFF)}
    if any(name not in trials for name in (*names.values(), *(f"uniform-{s:g}" for s in UNIFORM))):
        return []
    best = best_uniform(trials)
    lowest = trials[best]["total"]
    return [
        lower(
            f"cost, learned from {start:g} N/m below the best uniform one, {best.removeprefix('uniform-')}",
            trials[name]["total"],
            lowest,
        )
        for start, name in names.items()
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
            lambda setting: compared(setting, SOFT, "stiffness/mean", "mean stiffness [N/m]", low=1.0),
        ),
        (
            "digging-soft-gravel",
            "6, Fig. 16 left",
            "From 150 N/m more gravel is shoveled after learning.",
            "More load than before.",
            soft_learns_gravel,
        ),
        (
            "digging-soft-same-force",
            "6, Fig. 16 left",
            "From 150 N/m the forces do not really increase.",
            f"The force cost after learning is at most {SAME:g} times that before.",
            lambda setting: compared(setting, SOFT, "force", "force cost", high=SAME),
        ),
        (
            "digging-stiff-softens",
            "6, Fig. 16 right",
            "From 400 N/m the mean stiffness decreases.",
            "It is lower after learning.",
            lambda setting: compared(setting, STIFF, "stiffness/mean", "mean stiffness [N/m]", high=1.0),
        ),
        (
            "digging-stiff-force",
            "6, Fig. 16 right",
            "From 400 N/m the forces decrease.",
            "The force cost is lower after learning.",
            lambda setting: compared(setting, STIFF, "force", "force cost", high=1.0),
        ),
        (
            "digging-stiff-gravel",
            "6, Fig. 16 right",
            "From 400 N/m the gravel first decreases, and improves again in the second half of learning.",
            "Means of the gravel's term over the halves of the learning curve.",
            dip_and_recovery,
        ),
        (
            "digging-below-uniform",
            "6, Fig. 17",
            "Learned policies cost less than every uniform stiffness.",
            "From either start, lower than the best of them, over five trials on beds that no learning has met.",
            below_uniform,
        ),
        (
            "digging-best-uniform",
            "6, Fig. 17",
            "Among uniform stiffnesses the lowest cost is between 200 and 350 N/m.",
            "The one with the lowest mean cost of five trials.",
            best_between,
        ),
    )
)
