"""What a stable fit starts from: the samples of motions in normalised units, and their mixtures by EM.

Normalised means positions relative to the goal and velocities, each of unit root mean square.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from torchds.arrays import Array, like
from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError
from torchds.mixture import GaussianMixture

COVARIANCE_FLOOR = 1e-4  # in normalised units
# Per demonstration: neighbouring samples are not independent, and all of them would ask for too many Gaussians.
BIC_SAMPLES = 64


def fit_mixtures(
    demos: Demonstrations | Sequence[Demonstrations],
    n_components: int | Literal["bic"] | Sequence[int] = "bic",
    *,
    goal: Array | None = None,
    seed: int | Sequence[int] = 0,
    max_components: int = 15,
) -> GaussianMixture:
    """Mixtures of [x, v] by EM, one for each motion: what `fit_stable` starts from.

    EM sees normalised units and starts once. Motions with fewer components than the largest of the batch are padded by
    components of prior zero. "bic" counts 64 samples per demonstration, since neighbouring ones are not independent.

    Args:
        demos: one motion, or several for a batch.
        n_components: K for all, one K per motion, or "bic".
        goal: as for `fit_stable`.
        seed: of the k-means starts, one for all or one per motion.
        max_components: the largest K that "bic" tries.

    Raises:
        InvalidArgumentError, DegenerateMixtureError: as `fit_stable`.
    """
    for motion in sequence(demos):
        motion.check().warn()
    fits = fit_batch(sequence(demos), n_components, goal, seed, max_components)
    if isinstance(demos, Demonstrations):
        return GaussianMixture(fits.priors[0], fits.means[0], fits.covariances[0])
    return fits


def fit_batch(
    motions: Sequence[Demonstrations],
    n_components: int | Literal["bic"] | Sequence[int],
    goal: Array | None,
    seed: int | Sequence[int],
    max_components: int = 15,
) -> GaussianMixture:
    """The batch that `fit_mixtures` makes, also of a single motion."""
    samples = Samples.of(motions, goal)
    counts = _one_each("n_components", n_components, len(motions))
    fits = []
    for i, (motion, K, s) in enumerate(zip(motions, counts, _one_each("seed", seed, len(motions)), strict=True)):
        options = {"covariance_floor": COVARIANCE_FLOOR, "n_init": 1, "tol": 1e-3, "seed": s}
        y = torch.cat([samples.x[i], samples.v[i]], -1)[samples.weight[i] > 0]
        if K == "bic":
            parts = torch.split(y, [len(demo.x) for demo in motion])
            thinned = torch.cat([part[:: -(-len(part) // BIC_SAMPLES)] for part in parts])
            K = GaussianMixture.fit(thinned, "bic", max_components=max_components, **options).n_components
        fits.append(GaussianMixture.fit(y, K, **options))
    size = max(fit.n_components for fit in fits)

    def stack(name: str) -> Tensor:
        parts = []
        for fit in fits:
            part = getattr(fit, name)
            first = torch.zeros_like(part[:1]) if name == "priors" else part[:1]
            parts.append(torch.cat([part, first.expand(size - len(part), *part.shape[1:])]))
        return torch.stack(parts)

    return samples.restore(GaussianMixture(stack("priors"), stack("means"), stack("covariances")))


class Samples(NamedTuple):
    """The samples of a batch of motions, normalised and padded; float64."""

    x: Tensor  # (B, N, D) relative to the goal
    v: Tensor  # (B, N, D)
    weight: Tensor  # (B, N) sums to one, zero for padding
    goal: Tensor  # (B, D)
    x_scale: Tensor  # (B,) RMS of a coordinate
    v_scale: Tensor  # (B,)

    @classmethod
    def of(cls, motions: Sequence[Demonstrations], goal: Array | None) -> Samples:
        """Those of `motions`, towards `goal` `(D,)` or `(B, D)`; by default the mean of their last positions."""
        dims = sorted({motion.dim for motion in motions})
        if len(dims) != 1:
            raise InvalidArgumentError(
                f"the motions of a batch have to have one dimension, got {dims}; fit them one by one"
            )
        if goal is None:
            goal = torch.stack([torch.stack([demo.x[-1] for demo in motion]).mean(0) for motion in motions])
        goal = like("goal", goal, torch.empty(0, dtype=torch.float64))
        if goal.shape not in ((dims[0],), (len(motions), dims[0])) or not goal.isfinite().all():
            raise InvalidArgumentError(
                f"goal has to be finite and ({dims[0]},) or ({len(motions)}, {dims[0]}), got {goal.tolist()}"
            )
        goal = goal.expand(len(motions), dims[0])
        stacked = [motion.stacked() for motion in motions]
        x = [part.x.to("cpu", torch.float64) - g for part, g in zip(stacked, goal, strict=True)]
        v = [part.v.to("cpu", torch.float64) for part in stacked]
        x_scale, v_scale = (torch.stack([part.square().mean().sqrt() for part in parts]) for parts in (x, v))
        if not ((x_scale > 0) & (v_scale > 0)).all():
            raise InvalidArgumentError(
                "every motion has to move, got one with all positions at the goal or all velocities zero; leave it out"
            )
        pad = torch.nn.utils.rnn.pad_sequence
        return cls(
            pad(x, batch_first=True) / x_scale[:, None, None],
            pad(v, batch_first=True) / v_scale[:, None, None],
            pad([torch.full((len(part),), 1 / len(part), dtype=part.dtype) for part in x], batch_first=True),
            goal,
            x_scale,
            v_scale,
        )

    def normalise(self, mixture: GaussianMixture) -> GaussianMixture:
        """A batch of joint mixtures in the units of the data, in normalised ones."""
        shift, scale = self._units()
        means, covariances = mixture.means.to(scale), mixture.covariances.to(scale)
        scaled = covariances / (scale.mT * scale).unsqueeze(1)
        return GaussianMixture(mixture.priors.to(scale), (means - shift) / scale, scaled)

    def restore(self, mixture: GaussianMixture) -> GaussianMixture:
        """The inverse of `normalise`."""
        shift, scale = self._units()
        scaled = mixture.covariances * (scale.mT * scale).unsqueeze(1)
        return GaussianMixture(mixture.priors, mixture.means * scale + shift, scaled)

    def _units(self) -> tuple[Tensor, Tensor]:
        """Origin and scale of [x, v], each (B, 1, 2D)."""
        D = self.x.shape[-1]
        scale = torch.stack([self.x_scale, self.v_scale], -1).repeat_interleave(D, -1)
        return torch.cat([self.goal, torch.zeros_like(self.goal)], -1).unsqueeze(1), scale.unsqueeze(1)


def sequence(demos: Demonstrations | Sequence[Demonstrations]) -> Sequence[Demonstrations]:
    """One motion as a batch of one; several as they are.

    Raises:
        InvalidArgumentError: neither.
    """
    if isinstance(demos, Demonstrations):
        return [demos]
    motions = list(demos)
    if not motions or not all(isinstance(motion, Demonstrations) for motion in motions):
        raise InvalidArgumentError(f"demos has to be Demonstrations or a sequence of them, got {demos!r}")
    return motions


def _one_each(name: str, value: int | str | Sequence[int], n: int) -> list[Any]:
    """One value for each of n motions, from one for all or one each."""
    values = [value] * n if isinstance(value, (int, str)) else list(value)
    if len(values) != n:
        raise InvalidArgumentError(
            f"{name} has to be one for all or one for each of the {n} motions, got {len(values)}"
        )
    return values
