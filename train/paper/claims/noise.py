"""The claims about unconstrained noise: section 4.1 and the beginning of 4.2 (Fig. 5, Eq. 14-18)."""

from __future__ import annotations

import numpy as np
import torch

from torchds.exploration import Homogeneous
from train.paper.claims.base import Check, Claim, counted, each, lower, within
from train.paper.measured.base import Setting, course
from train.paper.measured.noise import DURATIONS, FAR, SIDE, diverging, imitated, relative_noise, velocity_noise
from train.paper.measured.via_points import letter

GRID = 40  # points along each side of the map


def noise_size(shape: str, setting: Setting) -> list[Check]:
    """Final costs with a tenth of the noise and with eight times as much."""
    usual = course(letter(shape, setting.runs, setting.seed))[-1]
    return [
        lower(
            f"{shape}, final cost, noise 0.1 below noise {noise}",
            usual,
            course(letter(shape, setting.runs, setting.seed, noise=noise))[-1],
        )
        for noise in (0.01, 0.8)
    ]


@torch.no_grad()
def uniform(setting: Setting) -> list[Check]:
    """Rank correlation of noise and distance, over the map of Fig. 5 and along the motion."""
    import scipy.stats  # takes a second

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


@torch.no_grad()
def half(setting: Setting) -> list[Check]:
    """On which share of the motion the noise is within 50 % of the desired one, with each of the two rules."""
    policy, path = imitated()
    checks = []
    for rule, name in (
        ("centre", "dividing by the mean, as in the paper"),
        ("moment", "dividing by the root mean square"),
    ):
        noise = relative_noise(policy, Homogeneous(policy, rule=rule), path)  # type: ignore[arg-type] # one of the rules
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
    alone = relative_noise(policy, homogeneous, policy.means)
    together = int(((alone - 1).abs() <= 0.5).sum())
    return [
        counted("centres where the noise of one Gaussian is as desired, in both directions", int(off.sum()), len(off)),
        counted("centres where that of the whole mixture is within 50 %", together, len(off)),
    ]


def unstable(shape: str, setting: Setting) -> list[Check]:
    """Motions of the learned policies from a grid of starts around the demonstrations."""
    diverged = diverging(letter(shape, setting.runs, setting.seed))  # (runs, starts)
    some = diverged.any(-1)
    share = 100 * float(diverged.double().mean())
    what = f"{shape}, learned policies with diverging motions ({share:.0f} % of all {diverged.numel()} motions diverge)"
    return [counted(what, int(some.sum()), len(some), 0.5)]


CLAIMS = (
    Claim(
        "noise-size",
        "4.1",
        "With too little exploration noise improvement is slow, with too much the trials are poor.",
        "Noise 0.1, as in the experiments, ends below a tenth and eight times of it, for both letters.",
        each(noise_size),
    ),
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
    Claim(
        "unconstrained",
        "4.2",
        "Without constraints the result is generally an unstable model with diverging motions.",
        f"At least half of the learned policies have a motion that, from a grid of {SIDE**2} starts among the demonstrations, "
        f"is more than {FAR:g} extents away after {DURATIONS} durations; one is enough, the share of all stands beside.",
        each(unstable),
    ),
)
