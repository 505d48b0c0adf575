"""The claims of section 3: policy search on via-points (Figs 2 to 4)."""

from __future__ import annotations

import numpy as np
import torch

from train.paper.claims.base import Check, Claim, alike, changes, counted, each, lower, within
from train.paper.measured.base import Setting, course, early_share, extent, learned, via_distances
from train.paper.measured.via_points import asymmetry, letter, uncontrolled

PASSED = 0.02  # of the motion's extent, about the size of a via-point in the figures
TERMS = ("via_points", "goal", "acceleration")  # of the task's own cost


# ------------------------------------------------------------------ Fig. 2


@torch.no_grad()
def via_points(shape: str, setting: Setting) -> list[Check]:
    """Whether the motions come nearer to the via-points, and pass them."""
    learner = letter(shape, setting.runs, setting.seed)
    task = learner.task
    (points,) = task.scene().via_points.values()
    first = task.rollout(learner.initial).x
    before = via_distances(first, points)
    after = via_distances(task.rollout(learner.policy).x, points)  # (runs, L)
    passed = after <= PASSED * extent(first)
    return [
        changes(f"{shape}, mean distance", float(before.mean()), after.mean(-1).numpy()),
        counted(
            f"{shape}, via-points passed within {PASSED * extent(first):.2f}", int(passed.sum()), passed.numel(), 0.9
        ),
    ]


def fast_fall(shape: str, setting: Setting) -> list[Check]:
    """How much of the fall of the via-point cost the first quarter of the updates brings."""
    share = early_share(course(letter(shape, setting.runs, setting.seed), "via_points"))
    return [changes(f"{shape}, share of the fall in the first quarter, against one half", 0.5, share, falls=False)]


def acceleration(shape: str, setting: Setting) -> list[Check]:
    """Whether the acceleration cost rises, and more slowly than the via-point cost falls."""
    learner = letter(shape, setting.runs, setting.seed)
    cost, via = course(learner, "acceleration"), course(learner, "via_points")
    quarter = (len(cost) - 1) // 4

    def relative(values: np.ndarray) -> np.ndarray:
        return np.abs(values[quarter] - values[0]) / values[0]

    return [
        changes(f"{shape}, acceleration cost", cost[0], cost[-1], falls=False),
        changes(
            f"{shape}, relative change in the first quarter, via-points → acceleration", relative(via), relative(cost)
        ),
    ]


def trade_off(shape: str, setting: Setting) -> list[Check]:
    """The share of the acceleration in the final cost."""
    learner = letter(shape, setting.runs, setting.seed)
    share = course(learner, "acceleration")[-1] / course(learner)[-1]
    return [within(f"{shape}, share of the acceleration in the final cost", share, low=0.1)]


def control(shape: str, setting: Setting) -> list[Check]:
    """The share of the control cost in the final cost, and the other terms learned without it."""
    with_it, without = letter(shape, setting.runs, setting.seed), uncontrolled(shape, setting.runs, setting.seed)
    share = course(with_it, "control")[-1] / course(with_it)[-1]
    others = [sum(course(learner, term)[-1] for term in TERMS) for learner in (with_it, without)]
    return [
        within(f"{shape}, share of the control cost in the final cost", share, high=0.1),
        alike(f"{shape}, the other terms with it and without", *others),
    ]


# ------------------------------------------------------------------ Figs 3 and 4


def pi2(shape: str, setting: Setting) -> list[Check]:
    """Final costs of PI^BB against those of PI²."""
    ours, theirs = letter(shape, setting.runs, setting.seed), letter(shape, setting.runs, setting.seed, optimizer="pi2")
    return [lower(f"{shape}, final cost, PI^BB below PI²", course(ours)[-1], course(theirs)[-1])]


@torch.no_grad()
def two_behaviours(setting: Setting) -> list[Check]:
    """How much the right motion differs from the mirrored left one."""
    learner = learned("two_starts", setting.runs, setting.seed)
    before, after = learner.task.rollout(learner.initial).x, learner.task.rollout(learner.policy).x
    left = extent(before[0])
    apart = float(asymmetry(before))
    return [
        within(
            "before: distance between the right and the mirrored left motion, share of their extent",
            apart / left,
            high=0.1,
        ),
        changes("that distance, learned", apart, asymmetry(after).numpy(), falls=False),
    ]


@torch.no_grad()
def two_sets(setting: Setting) -> list[Check]:
    """Each side's distances to its own via-points."""
    learner = learned("two_starts", setting.runs, setting.seed)
    task = learner.task
    before, after = task.rollout(learner.initial).x, task.rollout(learner.policy).x
    checks = []
    for i, (name, points) in enumerate(task.scene().via_points.items()):
        near = PASSED * extent(before[i])
        distances = via_distances(after[:, i], points)
        first = float(via_distances(before[i], points).mean())
        passed = distances <= near
        side = name.removeprefix("via-points, ")
        checks += [
            changes(f"{side}, mean distance", first, distances.mean(-1).numpy()),
            counted(f"{side}, via-points passed within {near:.2f}", int(passed.sum()), passed.numel(), 0.9),
        ]
    return checks


CLAIMS = (
    Claim(
        "via-points",
        "3.3, Fig. 2",
        "Learned motions pass through the via-points.",
        "The mean distance to them falls, and nine in ten are passed within 2 % of the motion's extent.",
        each(via_points),
    ),
    Claim(
        "fast-decrease",
        "3.3, Fig. 2",
        "The via-point cost falls fast at first.",
        "The first quarter of the roll-outs brings more than half of the fall.",
        each(fast_fall),
    ),
    Claim(
        "acceleration-rises",
        "3.3, Fig. 2",
        "The acceleration cost rises slowly meanwhile.",
        "It ends higher, and changes less in the first quarter, in proportion, than the via-point cost.",
        each(acceleration),
    ),
    Claim(
        "trade-off",
        "3.3, Fig. 2",
        "The final cost is a trade-off between via-points and acceleration.",
        "The acceleration is at least a tenth of the final cost.",
        each(trade_off),
    ),
    Claim(
        "control-cost",
        "3.3, Fig. 2",
        "The control cost only regularises.",
        "It is at most a tenth of the final cost, and learning without it ends with the same other terms.",
        each(control),
    ),
    Claim(
        "pibb-below-pi2",
        "3.3, Fig. 3",
        "The update of PI^BB ends at significantly lower costs than that of PI².",
        "So it does, for both letters.",
        each(pi2),
    ),
    Claim(
        "two-behaviours",
        "3.3, Fig. 4",
        "From two starts, motions that were alike become different.",
        "The distance between one and the mirror image of the other is small before, and rises.",
        two_behaviours,
    ),
    Claim(
        "two-sets",
        "3.3, Fig. 4",
        "Each of the two passes through the via-points of its own side.",
        "As for the claim via-points, on each side.",
        two_sets,
    ),
)
