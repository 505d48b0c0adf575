"""The claims of section 4: homogeneous and stable exploration (Figs 5, 7 and 8, Eq. 14-28)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy.stats
import torch
from torch import Tensor

import tasks
from torchds import GMRPolicy
from torchds.exploration import Homogeneous, Stable
from train.learning.learner import Learner
from train.options import ConstrainedReachingOptions
from train.paper.claims.base import Check, Claim, Setting, changes, counted, course, lower, within
from train.paper.claims.via_points import SIZE, UNSTABLE
from train.paper.figures import stable
from train.paper.figures.noise import velocity_noise
from train.searchers.base import Closure

EARLY, LATE = 10, 40  # updates: 100 and 400 roll-outs
GRID = 40  # points along each side of the map
DRAWS = 20_000


# ------------------------------------------------------------------ section 4.1


@cache
def imitated() -> tuple[GMRPolicy, Tensor]:
    """The N-shape as imitated, and the points `(T, 2)` on its way."""
    task = tasks.make("via_point", shape="N")
    with torch.no_grad():
        return task.policy(), task.rollout(task.policy()).x[:-1]


@torch.no_grad()
def uniform(setting: Setting) -> list[Check]:
    """Rank correlation of noise and distance, over the map of Fig. 5 and along the motion."""
    policy, path = imitated()
    ticks = torch.linspace(0, 1, GRID, dtype=path.dtype)
    low, high = path.amin(0), path.amax(0)
    places = {"over the map": low + torch.cartesian_prod(ticks, ticks) * (high - low), "along the motion": path}
    covariance = torch.eye(policy.pack().shape[-1], dtype=path.dtype)
    checks = []
    for name, x in places.items():
        correlation = scipy.stats.spearmanr(velocity_noise(policy, covariance, x), x.norm(dim=-1)).statistic
        checks.append(within(f"{name}, rank correlation of noise and distance from the origin", correlation, low=0.8))
    return checks


def noise_of(policy: GMRPolicy, homogeneous: Homogeneous, x: Tensor) -> Tensor:
    """Mean norm of the velocity noise at `x`, over the desired one."""
    covariance = policy.join(homogeneous.std()).square().diag()
    return velocity_noise(policy, covariance, x) / homogeneous.mean_speed


@torch.no_grad()
def half(setting: Setting) -> list[Check]:
    """Shares of the way."""
    policy, path = imitated()
    checks = []
    for rule, name in (
        ("centre", "dividing by the mean, as in the paper"),
        ("moment", "dividing by the root mean square"),
    ):
        noise = noise_of(policy, Homogeneous(policy, rule=rule), path)  # type: ignore[arg-type] # one of the rules
        inside = int(((noise - 1).abs() <= 0.5).sum())
        what = f"{name}, steps with noise within 50 % (from {float(noise.min()):.2f} to {float(noise.max()):.2f})"
        checks.append(counted(what, inside, len(noise)))
    return checks


@torch.no_grad()
def centres(setting: Setting) -> list[Check]:
    """The noise of each Gaussian by itself at its centre, Eq. 14-15."""
    policy, _ = imitated()
    homogeneous = Homogeneous(policy, rule="centre")
    std = homogeneous.std()
    variances = std["b"].square() + (std["A"].square() * policy.means.unsqueeze(-2).square()).sum(-1)  # (K, 2)
    mean = (0.5 * np.pi * variances).sqrt() / homogeneous.mean_speed  # Rayleigh
    off = (mean - 1).abs().amax(-1) < 1e-9
    alone = noise_of(policy, homogeneous, policy.means)
    together = int(((alone - 1).abs() <= 0.5).sum())
    return [
        counted("centres where the noise of one Gaussian is as desired, in both directions", int(off.sum()), len(off)),
        counted("centres where that of the whole mixture is within 50 %", together, len(off)),
    ]


# ------------------------------------------------------------------ section 4.2


class Course(NamedTuple):
    """A run of stable exploration, watched.

    Attributes:
        learner: finished.
        tried: roll-outs that satisfied the condition, and all.
        reached: policies after an update that did, and all.
    """

    learner: Learner
    tried: tuple[int, int]
    reached: tuple[int, int]


@cache
def watched(runs: int, seed: int) -> Course:
    """The constrained reach, with a certificate of every roll-out and every update."""
    tried, reached = [], []

    def stable(learner: Learner) -> Tensor:
        return learner.policy.certificate(learner.task.scene().goal, learner.task.P).stable

    def watch(closure: Closure, learner: Learner) -> Closure:
        def watched() -> Tensor:
            tried.append(stable(learner))
            return closure()

        return watched

    learner = Learner(ConstrainedReachingOptions(runs=runs, seed=seed), wrap=watch)
    learner.start()
    while learner.done < learner.n_updates:
        learner.update()
        reached.append(stable(learner))

    def count(parts: Sequence[Tensor]) -> tuple[int, int]:
        return int(sum(part.sum() for part in parts)), sum(part.numel() for part in parts)

    return Course(learner, count(tried), count(reached))


def stable_trials(setting: Setting) -> list[Check]:
    """Certificates of all roll-outs."""
    return [counted("roll-outs of all updates that satisfy the condition", *watched(setting.runs, setting.seed).tried)]


def stable_updates(setting: Setting) -> list[Check]:
    """Certificates of all updated policies, the final ones among them."""
    course_ = watched(setting.runs, setting.seed)
    final = course_.learner.policy.certificate(course_.learner.task.scene().goal, course_.learner.task.P).stable
    return [
        counted("policies of all updates that satisfy it", *course_.reached),
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


@cache
def variant(name: str, runs: int, seed: int) -> stable.Variant:
    """One exploration of Fig. 8, at all levels of noise."""
    return stable.learn(tasks.make(stable.TASK), name, runs, seed)


def slower(setting: Setting) -> list[Check]:
    """The cost at 100 and 400 roll-outs level by level, and the falls before, between and after at one of them."""
    cost = variant(stable.STABLE, setting.runs, setting.seed).cost
    early, late = (min(u, len(cost) - 1) for u in (EARLY, LATE))
    own = cost[:, stable.LEVELS.index(stable.SHOWN)]
    first, middle, last = own[0] - own[early], own[early] - own[late], own[late] - own[-1]
    return [
        *(
            changes(f"noise {level}, cost at 100 → 400 roll-outs", cost[early, i], cost[late, i])
            for i, level in enumerate(stable.LEVELS)
        ),
        changes(f"noise {stable.SHOWN}, fall of the cost, to 100 → from 100 to 400", first, middle),
        changes(f"noise {stable.SHOWN}, fall of the cost, from 100 to 400 → after 400", middle, last),
    ]


def compared(setting: Setting, other: str, update: int) -> list[Check]:
    """Costs of stable exploration below those of another, level by level."""
    ours, theirs = (variant(name, setting.runs, setting.seed) for name in (stable.STABLE, other))
    update = min(update, len(ours.cost) - 1)
    return [
        lower(f"noise {level}, {stable.STABLE} below {other}", ours.cost[update, i], theirs.cost[update, i])
        for i, level in enumerate(stable.LEVELS)
    ]


def collisions(setting: Setting) -> list[Check]:
    """Shares of colliding roll-outs, level by level."""
    ours, theirs = (variant(name, setting.runs, setting.seed) for name in (stable.STABLE, stable.FREE))
    return [
        lower(f"noise {level}, share of roll-outs that collide", ours.share[i], theirs.share[i])
        for i, level in enumerate(stable.LEVELS)
    ]


CLAIMS = (
    SIZE,
    Claim(
        "uniform-noise",
        "4.1, Fig. 5",
        "With the same variance on all parameters the velocity noise grows with the distance from the origin.",
        "Their rank correlation is at least 0.8; computed exactly, for the N.",
        uniform,
    ),
    Claim(
        "noise-at-centres",
        "4.1, Eq. 14-18",
        "The tuned noise is isotropic and cancels the dependency on the state at the centre of each Gaussian; with several "
        "Gaussians active it is still reasonable.",
        "At every centre, one Gaussian alone gives exactly the desired noise, and the mixture gives it within 50 %.",
        centres,
    ),
    Claim(
        "noise-within-half",
        "4.1, Fig. 5",
        "The tuned noise stays within 50 % of the desired one in the area that the motion visits.",
        "At every step of the imitated N; with the paper's rule, and with the default here.",
        half,
    ),
    UNSTABLE,
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
        lambda setting: compared(setting, stable.FREE, 10**9),
    ),
    Claim(
        "constrained-faster",
        "4.3, Fig. 8",
        "With the constraint the cost falls faster.",
        "The same after 100 roll-outs.",
        lambda setting: compared(setting, stable.FREE, EARLY),
    ),
    Claim(
        "constraint-helps",
        "4.3, Fig. 8",
        "It is the stability of every roll-out that helps.",
        "After 1000 roll-outs it ends lower than noise that only ties b to the goal and keeps nothing stable.",
        lambda setting: compared(setting, stable.TIED, 10**9),
    ),
    Claim(
        "collisions",
        "4.3, Fig. 8",
        "Without the constraint too many roll-outs are lost in collisions with the box.",
        "With it a smaller share of all roll-outs collides, at each level of noise.",
        collisions,
    ),
)
