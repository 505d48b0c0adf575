"""The claims of sections 4.2 and 4.3: stable exploration (Figs 7 and 8, Eq. 19-28)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchds.exploration import Stable
from train.paper.claims.base import Check, Claim, changes, counted, lower
from train.paper.measured.base import Setting, course
from train.paper.measured.stable import (
    EARLY,
    FREE,
    LATE,
    LEVELS,
    SHOWN,
    STABLE,
    TIED,
    certified,
    variant,
    watched,
)

DRAWS = 20_000


def stable_trials(setting: Setting) -> list[Check]:
    """Certificates of all roll-outs of all updates."""
    return [counted("roll-outs of all updates that satisfy the condition", *watched(setting.runs, setting.seed).tried)]


def stable_updates(setting: Setting) -> list[Check]:
    """Certificates of all updated policies, the final ones among them."""
    learned = watched(setting.runs, setting.seed)
    final = certified(learned.learner)
    return [
        counted("policies of all updates that satisfy it", *learned.reached),
        counted("final policies that do", int(final.sum()), len(final)),
    ]


def shrinkage(setting: Setting) -> list[Check]:
    """η of random matrices against the eigenvalues of what it gives."""
    generator = torch.Generator().manual_seed(setting.seed)
    draw, noise = torch.randn(2, DRAWS, 2, 2, generator=generator, dtype=torch.float64)
    stable_part = -draw @ draw.mT - 1e-3 * torch.eye(2, dtype=torch.float64)
    symmetric = 0.5 * (noise + noise.mT)
    eta = Stable.shrinkage(stable_part, noise)
    step = 1e-6

    def definite(factor: Tensor) -> Tensor:
        return torch.linalg.eigvalsh(stable_part + factor[:, None, None] * symmetric)[:, -1] < 0

    # The paper's search, which tries 1, 0.9, ..., 0.
    tries = torch.arange(10, -1, -1, dtype=torch.float64) / 10
    passed = torch.stack([definite(factor.expand(DRAWS)) for factor in tries])
    stepped = tries[passed.double().argmax(0)]
    close = (stepped <= eta + step) & (stepped >= eta - 0.1 - step)
    return [
        counted("draws with η > 0", int((eta > 0).sum()), DRAWS),
        counted(f"draws that are stable with {1 - step} η", int(definite((1 - step) * eta).sum()), DRAWS),
        counted(
            f"draws with η = 1, or unstable with {1 + step} η",
            int(((eta == 1) | ~definite((1 + step) * eta)).sum()),
            DRAWS,
        ),
        counted("draws where the paper's steps of 0.1 find η to a step", int(close.sum()), DRAWS),
    ]


# ------------------------------------------------------------------ section 4.3


def shorter(setting: Setting) -> list[Check]:
    """The length beyond the shortest path."""
    length = course(watched(setting.runs, setting.seed).learner, "path_length")
    early = min(EARLY, len(length) - 1)
    fall = (length[0] - length[early]) / (length[0] - length[-1])
    return [
        changes("length beyond the shortest path, after 100 roll-outs", length[0], length[early]),
        changes("share of its whole fall by then, against one half", 0.5, fall, falls=False),
    ]


def slower(setting: Setting) -> list[Check]:
    """The cost at 100 and 400 roll-outs level by level, and the falls before, between and after at one of them."""
    cost = variant(STABLE, setting.runs, setting.seed).cost
    early, late = (min(u, len(cost) - 1) for u in (EARLY, LATE))
    own = cost[:, LEVELS.index(SHOWN)]
    first, middle, last = own[0] - own[early], own[early] - own[late], own[late] - own[-1]
    return [
        *(
            changes(f"noise {level}, cost at 100 → 400 roll-outs", cost[early, i], cost[late, i])
            for i, level in enumerate(LEVELS)
        ),
        changes(f"noise {SHOWN}, fall of the cost, to 100 → from 100 to 400", first, middle),
        changes(f"noise {SHOWN}, fall of the cost, from 100 to 400 → after 400", middle, last),
    ]


def compared(setting: Setting, other: str, update: int) -> list[Check]:
    """Costs of stable exploration below those of another, level by level."""
    ours, theirs = (variant(name, setting.runs, setting.seed) for name in (STABLE, other))
    update = min(update, len(ours.cost) - 1)
    return [
        lower(f"noise {level}, {STABLE} below {other}", ours.cost[update, i], theirs.cost[update, i])
        for i, level in enumerate(LEVELS)
    ]


def collisions(setting: Setting) -> list[Check]:
    """Shares of colliding roll-outs, level by level."""
    ours, theirs = (variant(name, setting.runs, setting.seed) for name in (STABLE, FREE))
    return [
        lower(f"noise {level}, share of roll-outs that collide", ours.share[i], theirs.share[i])
        for i, level in enumerate(LEVELS)
    ]


CLAIMS = (
    Claim(
        "stable-trials",
        "4.2, Eq. 19-23",
        "With shaped noise every roll-out satisfies the conditions of SEDS.",
        "All of them, in all runs.",
        stable_trials,
    ),
    Claim(
        "stable-updates",
        "4.2, Eq. 24-28",
        "The update keeps the conditions.",
        "After every update of every run, and at the end.",
        stable_updates,
    ),
    Claim(
        "shrinkage",
        "4.2",
        "A small enough η > 0 always keeps N + ηS negative definite, and trying 1, 0.9, ... finds one.",
        "The closed form is positive, stable just below and unstable just above, and the paper's steps find it to a step.",
        shrinkage,
    ),
    Claim(
        "length-falls",
        "4.3, Fig. 7",
        "After 100 roll-outs the motion is already much shorter.",
        "The length falls, and more than half of its whole fall is made by then.",
        shorter,
    ),
    Claim(
        "slow-decrease",
        "4.3, Fig. 7",
        "The cost goes on falling slowly until about 400 roll-outs.",
        "It falls from 100 to 400 roll-outs at each of five levels of noise; at the task's own, by less than before and by "
        "less still after 400.",
        slower,
    ),
    Claim(
        "constrained-lower",
        "4.3, Fig. 8",
        "With the constraint the cost ends lower.",
        "After 1000 roll-outs, against independent noise on A and b, at each of five levels of noise.",
        lambda setting: compared(setting, FREE, 10**9),
    ),
    Claim(
        "constrained-faster",
        "4.3, Fig. 8",
        "With the constraint the cost falls faster.",
        "The same after 100 roll-outs.",
        lambda setting: compared(setting, FREE, EARLY),
    ),
    Claim(
        "constraint-helps",
        "4.3, Fig. 8",
        "It is the stability of every roll-out that helps.",
        "After 1000 roll-outs it ends lower than noise that only ties b to the goal and keeps nothing stable.",
        lambda setting: compared(setting, TIED, 10**9),
    ),
    Claim(
        "collisions",
        "4.3, Fig. 8",
        "Without the constraint too many roll-outs are lost in collisions with the box.",
        "With it a smaller share of all roll-outs collides, at each level of noise.",
        collisions,
    ),
)
