"""Stable systems fitted to demonstrations, many at once (section 4.3).

A fit starts from a mixture found by EM and learns gating, slopes and metric by Adam with exact gradients. The condition
(`torchds.stability`) is built into the parameters, so no constraint is left to enforce. Everything happens in
normalised units: positions relative to the goal and velocities, each of unit root mean square.

Stability: stable.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from torchds.arrays import Array, count, number
from torchds.demonstrations import Demonstrations
from torchds.errors import DemonstrationWarning, InvalidArgumentError, UnknownNameError
from torchds.mixture import GaussianMixture
from torchds.policy import GMRPolicy
from torchds.stability import Certificate
from torchds.starts import Samples, fit_batch, sequence
from torchds.trainable import TrainableMixture

Condition = Literal["none", "seds", "p-qlf"]
Objective = Literal["velocity", "likelihood"]

TAPER = 1.0  # distance to the goal [RMS distance] from which on the tube around the demonstrations narrows
SOFTNESS = 0.05  # [RMS speed] errors below count as squares, above by their length
RATE, RATE_WEIGHT = 0.3, 0.3  # a rate of convergence that is asked for, not enforced: motions do not creep at their end
METRIC_STARTS, METRIC_STEPS, METRIC_SAMPLES = 12, 200, 125


class StableFit(NamedTuple):
    """What `fit_stable` returns; `*batch` is empty for one set of demonstrations.

    Attributes:
        policy: in the units of the demonstrations; components that a fit does not have carry prior zero.
        goal: `(*batch, D)` x*, with b_k = −A_k x*.
        P: `(*batch, D, D)` of the condition, of trace D; the identity for "seds" and "none".
        loss: `(*batch,)` at the end, in normalised units, at the demonstrated positions.
        n_components: `(*batch,)` K of each fit.
    """

    policy: GMRPolicy
    goal: Tensor
    P: Tensor
    loss: Tensor
    n_components: Tensor

    def certificate(self) -> Certificate:
        """The policy's certificate for this goal and P."""
        return self.policy.certificate(self.goal, self.P)

    def save(self, path: str | Path, *, names: Sequence[str] = (), units: str = "", dt: float | None = None) -> None:
        """Write the policy with its goal and P to one file, see `GMRPolicy.save`."""
        self.policy.save(path, goal=self.goal, P=self.P, names=names, units=units, dt=dt)


@torch.enable_grad()
def fit_stable(
    demos: Demonstrations | Sequence[Demonstrations],
    n_components: int | Literal["bic"] | Sequence[int] = "bic",
    condition: Condition = "p-qlf",
    objective: Objective = "velocity",
    *,
    margin: float = 0.03,
    goal: Array | None = None,
    start: GaussianMixture | None = None,
    seed: int | Sequence[int] = 0,
    spread: float = 0.1,
    direction: float = 1.0,
    n_steps: int = 600,
    lr: float = 0.03,
) -> StableFit:
    r"""Fit systems ẋ = Σ_k h_k(x) A_k (x − x*) that end at their goal from everywhere, one or a batch of them.

    With z_n = (x_n − x*) + s_n ε, ε drawn anew at every step, the objective "velocity" is the mean over samples of

    .. math:: \sqrt{|v_n - f(z_n)|^2 + softness^2} + direction\,(1 - \cos\angle(v_n, f(z_n))),

    the other is the likelihood of [z_n, v_n]. The width s_n = spread tanh(|x_n − x*|) asks for the demonstrated velocity
    in a tube around the demonstrations that narrows to nothing at the goal; it is what keeps a fit from overfitting.

    Args:
        demos: one motion, or several, of one dimension; the same may be given several times, with other seeds. Stiffness that
            they carry is left out, with a `DemonstrationWarning`: what is stable is the motion.
        n_components: K for all, one K per motion, or "bic" (see `fit_mixtures`).
        condition: "seds" (P = I), "p-qlf" (P is learned) or "none" (nothing but b_k = −A_k x* holds).
        objective: "velocity" or "likelihood".
        margin: the rate of convergence that is certain, [RMS speed / RMS distance to the goal], above zero. In 1/s, the fit's
            `certificate().margin` tells.
        goal: `(D,)` or `(B, D)` x*; by default the mean of the last positions of each motion.
        start: what `fit_mixtures` gave for these motions; fitted here by default.
        seed: of the k-means starts, one for all or one per motion; the jitter is the same for all.
        spread: width of the tube, standard deviation [RMS distance to the goal].
        direction: weight of the error of direction, for "velocity".
        n_steps: of Adam, with a learning rate that rises for a fifth of them and then falls to zero.
        lr: the largest learning rate.

    Raises:
        UnknownNameError: `condition` or `objective`.
        InvalidArgumentError: an argument out of its range or of the wrong length, or motions of several dimensions.
        DegenerateMixtureError: see `GaussianMixture.fit`.

    Example:
        >>> import torch, torchds
        >>> fit = torchds.fit_stable(torchds.load_lasa("Angle", 3).every(10), n_components=4, n_steps=50)
        >>> bool(fit.certificate().stable), fit.policy.n_components
        (True, 4)
    """
    for kind, name, known in (("condition", condition, Condition), ("objective", objective, Objective)):
        if name not in get_args(known):
            raise UnknownNameError(kind, name, get_args(known))
    margin = number("margin", margin, "above 0 and finite", lambda n: 0 < n < math.inf)
    for option, value in {"spread": spread, "direction": direction, "lr": lr}.items():
        number(option, value, "finite and ≥ 0", lambda n: 0 <= n < math.inf)
    n_steps = count("n_steps", n_steps, 10)
    for motion in sequence(demos):
        motion.check().warn(stacklevel=4)  # past the decorator
    if any(demo.stiffness is not None for motion in sequence(demos) for demo in motion):
        warnings.warn(
            "the demonstrations carry a stiffness, which is left out: a stable fit is of the motion",
            DemonstrationWarning,
            stacklevel=3,
        )
    samples = Samples.of(sequence(demos), goal)
    batch, D = samples.x.shape[0], samples.x.shape[-1]
    if start is None:
        start = fit_batch(sequence(demos), n_components, goal, seed)
    elif start.means.ndim == 2:
        start = GaussianMixture(*(part.unsqueeze(0) for part in (start.priors, start.means, start.covariances)))
    if start.batch_shape != (batch,) or start.means.shape[-1] != 2 * D:
        raise InvalidArgumentError(
            f"start has to be {batch} mixtures of {2 * D} variables, [x, v] of each motion, got {start!r}"
        )
    start = samples.normalise(start)

    P = None if condition == "none" else torch.eye(D, dtype=torch.float64).repeat(batch, 1, 1)
    if condition == "p-qlf":
        P = _initial_metric(samples)
    model = TrainableMixture(
        start, _regress(start, samples), P, margin=margin, learn_metric=condition == "p-qlf"
    ).float()
    x, v, weight = samples.x.float(), samples.v.float(), samples.weight.float()
    width = spread * torch.tanh(x.norm(dim=-1, keepdim=True) / TAPER)
    noise = Noise((weight > 0).sum(-1).tolist())

    def losses(points: Tensor) -> Tensor:
        A, P = model.slopes_and_metric()
        likelihood = objective == "likelihood"
        each = -model.log_likelihood(points, v, A) if likelihood else _velocity_loss(v, model(points, A), direction)
        return (weight * each).sum(-1) + RATE_WEIGHT * model.slowness(A, P, RATE)

    optimizer = torch.optim.Adam(model.parameters(), lr=lr, betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, lr, total_steps=n_steps, pct_start=0.2)
    for _ in range(n_steps):
        optimizer.zero_grad()
        torch.autograd.backward(losses(x + width * noise.like(x)).sum())
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        loss = losses(x)
        return _result(model.double(), samples, loss, single=isinstance(demos, Demonstrations))


class Noise:
    """Unit normals for a batch of motions, the same for all of one length, so that a fit does not depend on its batch.

    Args:
        lengths: numbers of samples of the motions.
    """

    def __init__(self, lengths: Sequence[int]) -> None:
        self.lengths = lengths
        self.generators = {n: torch.Generator().manual_seed(0) for n in lengths}

    def like(self, x: Tensor) -> Tensor:
        """New ones in the shape of `x` `(B, N, D)`, zero for the padding."""
        drawn = {
            n: torch.nn.functional.pad(
                torch.randn(n, x.shape[-1], generator=generator, dtype=x.dtype), (0, 0, 0, x.shape[1] - n)
            )
            for n, generator in self.generators.items()
        }
        return torch.stack([drawn[n] for n in self.lengths])


def _regress(start: GaussianMixture, samples: Samples, ridge: float = 1e-3) -> Tensor:
    """Slopes (B, K, D, D) of the least squares through the goal, weighted by the gating that the fit starts with."""
    x, v, D = samples.x, samples.v, samples.x.shape[-1]
    weight = start.marginal(0, D).component_log_prob(x).softmax(-1) * samples.weight.unsqueeze(-1)  # (B, N, K)
    weighted = weight.mT.unsqueeze(-1) * x.unsqueeze(1)  # (B, K, N, D)
    K = (start.priors > 0).sum(-1).to(x)  # of each motion: padding is no component
    damping = (ridge / K)[:, None, None, None] * torch.eye(D, dtype=x.dtype)
    slopes: Tensor = torch.linalg.solve(weighted.mT @ x.unsqueeze(1) + damping, weighted.mT @ v.unsqueeze(1)).mT
    return slopes


def _velocity_loss(v: Tensor, predicted: Tensor, direction: float) -> Tensor:
    """The term of each sample, `(B, N)`. A length instead of its square forgives single samples."""
    norms = (v.square().sum(-1) + 1e-8).sqrt() * (predicted.square().sum(-1) + 1e-4).sqrt()
    turned = 1 - (v * predicted).sum(-1) / norms
    return ((v - predicted).square().sum(-1) + SOFTNESS**2).sqrt() + direction * turned


def _initial_metric(samples: Samples) -> Tensor:
    """The P (B, D, D) of trace D for which V = xᵀ P x rises least along the demonstrations.

    The mean positive part of the cosine of P x and v is minimised from several random starts; the best of them is kept.
    """
    x, v, count = _thinned(samples)
    v = v / v.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    B, _, D = x.shape
    generator = torch.Generator().manual_seed(0)
    raw = torch.randn(METRIC_STARTS, 1, D, D, generator=generator, dtype=x.dtype)
    raw[0] = 0.0  # the first start is P = I
    raw = raw.repeat(1, B, 1, 1).requires_grad_()

    def metric() -> Tensor:
        factor = raw.tril(-1) + torch.diag_embed(raw.diagonal(dim1=-2, dim2=-1).exp())
        return factor @ factor.mT

    def rise() -> Tensor:
        gradient = x @ metric()  # (starts, B, N, D)
        cosine: Tensor = (gradient * v).sum(-1) / gradient.norm(dim=-1).clamp(min=1e-9)
        return cosine.clamp(min=0).sum(-1) / count + 1e-3 * raw.square().mean((-2, -1))

    optimizer = torch.optim.Adam([raw], lr=0.2, betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 0.2, total_steps=METRIC_STEPS, pct_start=0.2)
    for _ in range(METRIC_STEPS):
        optimizer.zero_grad()
        torch.autograd.backward(rise().sum())
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        P = metric()[rise().argmin(0), torch.arange(B)]
        return P * (D / P.diagonal(dim1=-2, dim2=-1).sum(-1))[:, None, None]


def _thinned(samples: Samples) -> tuple[Tensor, Tensor, Tensor]:
    """Every n-th sample of each motion, by its own length: x and v (B, M, D), padded by zeros, and their numbers (B,)."""
    parts = []
    for x, v, weight in zip(samples.x, samples.v, samples.weight, strict=True):
        n = int((weight > 0).sum())
        stride = max(n // METRIC_SAMPLES, 1)
        parts.append((x[:n:stride], v[:n:stride]))
    pad = torch.nn.utils.rnn.pad_sequence
    x, v = (pad(list(part), batch_first=True) for part in zip(*parts, strict=True))
    return x, v, torch.tensor([len(part) for part, _ in parts], dtype=x.dtype)


def _result(model: TrainableMixture, samples: Samples, loss: Tensor, single: bool) -> StableFit:
    """Back to the units of the data; padding becomes a copy of the first component, with prior zero."""
    mask, goal = model.mask, samples.goal.unsqueeze(1)
    x_scale, rate = samples.x_scale[:, None, None], (samples.v_scale / samples.x_scale)[:, None, None, None]
    means = _padded(model.mean, mask[..., None]) * x_scale + goal
    covariances = _padded(model.covariances, mask[..., None, None]) * x_scale.unsqueeze(-1) ** 2
    A = _padded(model.A, mask[..., None, None]) * rate
    P = torch.eye(goal.shape[-1], dtype=A.dtype).repeat(len(A), 1, 1) if model.P is None else model.P
    b = -(A @ goal.unsqueeze(-1)).squeeze(-1)
    parts = [model.priors, means, covariances, A, b, samples.goal, P, loss.double(), mask.sum(-1)]
    priors, means, covariances, A, b, x_star, P, loss, n = (part[0] if single else part for part in parts)
    return StableFit(GMRPolicy(priors, means, covariances, A, b), x_star, P, loss, n)


def _padded(value: Tensor, mask: Tensor) -> Tensor:
    return torch.where(mask, value, value[:, :1])
