"""The claims of section 3: policy search on via-points (Figs 2 to 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor

import tasks
from torchds.rollouts import rollout
from train.learning.learner import Learner
from train.options import ViaPointOptions
from train.paper.claims.base import (
    Check,
    Claim,
    Setting,
    alike,
    changes,
    counted,
    course,
    early_share,
    lower,
    shared,
    within,
)
from train.paper.figures.base import via_distances
from train.paper.figures.via_points import SHAPES, asymmetry

PASSED = 0.02  # of the motion's extent, about the size of a via-point in the figures
TERMS = ("via_points", "goal", "acceleration")  # of the task's own cost


def letter(shape: str, setting: Setting, **options: object) -> Learner:
    """The via-point task with one letter, learned."""
    return shared("via_point", setting.runs, setting.seed, shape=shape, **options)


def extent(x: Tensor) -> float:
    """The diagonal of the box around motions `(..., D)`."""
    points = x.reshape(-1, x.shape[-1])
    return float((points.amax(0) - points.amin(0)).norm())


def each(measure: Callable[[str, Setting], list[Check]]) -> Callable[[Setting], list[Check]]:
    """The checks of both letters."""
    return lambda setting: [check for shape in SHAPES for check in measure(shape, setting)]


# ------------------------------------------------------------------ Fig. 2


@torch.no_grad()
def via_points(shape: str, setting: Setting) -> list[Check]:
    """Distances to the via-points."""
    learner = letter(shape, setting)
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
    """What the first quarter brings."""
    share = early_share(course(letter(shape, setting), "via_points"))
    return [changes(f"{shape}, share of the fall in the first quarter, against one half", 0.5, share, falls=False)]


def acceleration(shape: str, setting: Setting) -> list[Check]:
    """The acceleration's course, and the via-points' beside it."""
    learner = letter(shape, setting)
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
    """The share of the acceleration."""
    learner = letter(shape, setting)
    share = course(learner, "acceleration")[-1] / course(learner)[-1]
    return [within(f"{shape}, share of the acceleration in the final cost", share, low=0.1)]


@cache
def uncontrolled(shape: str, runs: int, seed: int) -> Learner:
    """Learned without a control cost."""
    task = tasks.make("via_point", shape=shape)
    task.search = replace(task.search, control_weight=0.0)
    return Learner(ViaPointOptions(runs=runs, seed=seed, shape="N" if shape == "N" else "P"), task).learn()


def control(shape: str, setting: Setting) -> list[Check]:
    """The share of the control cost, and the other terms without it."""
    with_it, without = letter(shape, setting), uncontrolled(shape, setting.runs, setting.seed)
    share = course(with_it, "control")[-1] / course(with_it)[-1]
    others = [sum(course(learner, term)[-1] for term in TERMS) for learner in (with_it, without)]
    return [
        within(f"{shape}, share of the control cost in the final cost", share, high=0.1),
        alike(f"{shape}, the other terms with it and without", *others),
    ]


# ------------------------------------------------------------------ Figs 3 and 4


def pi2(shape: str, setting: Setting) -> list[Check]:
    """Final costs."""
    ours, theirs = letter(shape, setting), letter(shape, setting, optimizer="pi2")
    return [lower(f"{shape}, final cost, PI^BB below PI²", course(ours)[-1], course(theirs)[-1])]


@torch.no_grad()
def two_behaviours(setting: Setting) -> list[Check]:
    """How much the right motion differs from the mirrored left one."""
    learner = shared("two_starts", setting.runs, setting.seed)
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
    learner = shared("two_starts", setting.runs, setting.seed)
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


# ------------------------------------------------------------------ noise and stability of what is learned (section 4)


def noise_size(shape: str, setting: Setting) -> list[Check]:
    """Final costs with a tenth of the noise and with eight times as much."""
    usual = course(letter(shape, setting))[-1]
    other = partial(letter, shape, setting)
    return [
        lower(f"{shape}, final cost, noise 0.1 below noise {noise}", usual, course(other(noise=noise))[-1])
        for noise in (0.01, 0.8)
    ]


FAR, SIDE, LONG = 10.0, 10, 4  # extents of the motion; starts along each side of their grid; durations of the motion


@torch.no_grad()
def unstable(shape: str, setting: Setting) -> list[Check]:
    """Motions of the learned policies from a grid of starts around the demonstrations."""
    learner = letter(shape, setting)
    seen = torch.cat([demonstration.x for demonstration in learner.task.demonstrations])
    low, high = seen.amin(0), seen.amax(0)
    ticks = torch.linspace(0, 1, SIDE, dtype=seen.dtype)
    starts = low + torch.cartesian_prod(ticks, ticks) * (high - low)
    motion = learner.task.motion()
    end = rollout(learner.policy, starts, LONG * motion.n_steps, motion.dt).x[..., -1, :]
    diverged = ~((end - learner.task.scene().goal).norm(dim=-1) <= FAR * extent(seen))  # (runs, starts)
    some = diverged.any(-1)
    share = 100 * float(diverged.double().mean())
    what = f"{shape}, learned policies with diverging motions ({share:.0f} % of {len(starts)} starts diverge)"
    return [counted(what, int(some.sum()), len(some), 0.5)]


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
SIZE = Claim(
    "noise-size",
    "4.1",
    "With too little exploration noise improvement is slow, with too much the trials are poor.",
    "Noise 0.1, as in the experiments, ends below a tenth and eight times of it, for both letters.",
    each(noise_size),
)
UNSTABLE = Claim(
    "unconstrained",
    "4.2",
    "Without constraints the result is generally an unstable model with diverging motions.",
    f"At least half of the learned policies have a motion that, from a grid of starts among the demonstrations, is more than "
    f"{FAR:g} extents away after {LONG} durations.",
    each(unstable),
)
