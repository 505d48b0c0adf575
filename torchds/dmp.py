r"""Dynamic movement primitives: motions driven by a phase.

Ijspeert et al., *Dynamical movement primitives: learning attractor models for motor behaviors*, Neural Computation 25 (2013),
doi 10.1162/NECO_a_00393, whose symbols are kept: `y` position, `z` scaled velocity, `s` phase, `g` goal, `τ` duration.

Stability: experimental.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from torchds import visits
from torchds.arrays import Array, count, like, number, real
from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError
from torchds.moments import Rollout
from torchds.policy import GMRPolicy

ALPHA_Z = 25.0  # of the spring and damper, critically damped with β_z = α_z / 4
ALPHA_S = math.log(100.0)  # of the phase: a hundredth is left when the motion ends


class _Phased(Rollout):
    """A roll-out whose inputs are phases, and whose features are ψ_k s / Σ ψ, each beside a zero."""

    @property
    def gating(self) -> Tensor:
        """ψ_k / Σ ψ `(*batch, *points, T, K)`."""
        return self.features[..., ::2] / self.inputs


class State(NamedTuple):
    """Where a primitive is: `y` and `z` `(*batch, *points, O)`, and the phase `s`, one for all or `(*batch, *points, 1)`."""

    y: Tensor
    z: Tensor
    s: Tensor


class DMP(GMRPolicy):
    r"""A discrete dynamic movement primitive: a spring to the goal, and a forcing term that fades with its own clock.

    .. math:: τ\dot z = α_z (β_z (g - y) - z) + α_z β_z f(s), \quad τ\dot y = z, \quad τ\dot s = -α_s s, \quad
        f(s) = \frac{\sum_k ψ_k(s) w_k}{\sum_k ψ_k(s)} s, \quad ψ_k(s) = \exp(-(s - c_k)^2 / (2 σ_k^2)).

    The forcing term is a `GMRPolicy` whose one input is the phase: slopes `A` `(*batch, K, O, 1)` are the weights w, offsets
    `b` are zero and frozen. What is linear in features works as for any other policy: θ, rows, control cost, batches. f is not
    multiplied by g − y(0), which vanishes where a motion ends where it began, and it has the unit of positions: it moves the
    end of the spring.

    Args:
        weights: `(*batch, K, O)` w.
        goal: `(O,)` g.
        duration: τ [s]; the phase begins at one and is at a hundredth after this time.

    Raises:
        InvalidArgumentError: shapes that do not fit, fewer than two basis functions, or a duration that is not positive.
    """

    goal: Tensor
    tau: Tensor

    def __init__(self, weights: Array, goal: Array, duration: float) -> None:
        w = real("weights", weights)
        if w.ndim < 2 or w.shape[-2] < 2:
            raise InvalidArgumentError(f"weights have to be (*batch, K, O) with K of at least 2, got {tuple(w.shape)}")
        K, O = w.shape[-2:]
        tau = number("duration", duration, "positive and finite", lambda time: 0 < time < math.inf)
        centers = torch.exp(-ALPHA_S * torch.linspace(0, 1, K, dtype=w.dtype, device=w.device))  # equal steps of time
        width = torch.cat([centers[:-1] - centers[1:], centers[-2:-1] - centers[-1:]])
        priors = width / width.sum()  # so that all ψ are equally high
        super().__init__(priors, centers[:, None], width.square()[:, None, None], w.unsqueeze(-1), torch.zeros_like(w))
        self.b.requires_grad_(False)
        self.register_buffer("tau", torch.tensor(tau, dtype=torch.float64, device=w.device))
        self.register_buffer("goal", like("goal", goal, w))
        if self.goal.shape != (O,):
            raise InvalidArgumentError(
                f"goal has to be ({O},) for weights of {O} dimensions, got {tuple(self.goal.shape)}"
            )

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_basis: int, goal: Array | None = None, rest: float = 0.25) -> DMP:
        """Weights whose forcing term is that of the demonstrations, in the least squares over all samples.

        Args:
            demonstrations: each is read as one run through the phase; the mean of their durations is τ.
            n_basis: K.
            goal: `(O,)` g; None for the mean end.
            rest: for how long the motion stays at the goal afterwards, in shares of its duration. Where nothing says so, the
                last forces of a motion that stops at once go on, and take it away again.

        Raises:
            InvalidArgumentError: see `DMP`; also a rest that is negative or not finite.
        """
        ends = torch.stack([d.x[-1] for d in demonstrations]).mean(0)
        rest = number("rest", rest, "finite and at least 0", lambda share: 0 <= share < math.inf)
        times = [(len(d.x) - 1) * d.dt for d in demonstrations]
        empty = ends.new_zeros(count("n_basis", n_basis, 2), len(ends))
        primitive = cls(empty, ends if goal is None else goal, math.fsum(times) / len(times))
        features, targets = [], []
        for d, tau in zip(demonstrations, times, strict=True):
            n = round(rest * len(d.x))
            s = torch.exp(-ALPHA_S * d.dt / tau * torch.arange(len(d.x) + n, dtype=d.x.dtype)).unsqueeze(-1)
            (acceleration,) = torch.gradient(d.v, spacing=d.dt, dim=0)
            spring = primitive.goal - d.x - 4 / ALPHA_Z * tau * d.v
            targets.append(F.pad(4 / ALPHA_Z**2 * tau**2 * acceleration - spring, (0, 0, 0, n)))
            features.append(primitive.features(s)[..., ::2])
        w = torch.linalg.lstsq(torch.cat(features), torch.cat(targets)).solution
        return cls(w, primitive.goal, primitive.duration)

    @property
    def duration(self) -> float:
        """τ [s]."""
        return float(self.tau)

    def save(self, *args: Any, **about: Any) -> None:
        """Refuse: files of policies have no phase.

        Raises:
            InvalidArgumentError: always, with what keeps a primitive.
        """
        raise InvalidArgumentError(
            "a file of a policy has no phase, got a primitive; keep torch.save(primitive.state_dict(), path), and load that "
            "into one of as many basis functions and dimensions"
        )

    # ------------------------------------------------------------------ the forcing term is linear in features

    def features(self, x: Array) -> Tensor:
        """ψ_k(s) s / Σ ψ, and zero for the frozen offsets, `(..., 2 K)` for the phase `x` `(..., 1)`."""
        s = self._checked(x)
        return (self.gating(s).unsqueeze(-1) * F.pad(s, (0, 1)).unsqueeze(-2)).flatten(-2)

    def feature_gating(self, features: Tensor) -> Tensor:
        """ψ_k / Σ ψ of each of the features; zero where these are zero, as those of a roll-out that failed."""
        active = features[..., ::2]
        total = active.sum(-1, keepdim=True)
        return (active / total.where(total > 0, 1.0)).repeat_interleave(2, -1)

    # ------------------------------------------------------------------ motion

    def begin(self, y: Array) -> State:
        """At rest at `y` `(*points, O)`, for each of the batch, with the phase at one."""
        place = like("y", y, self.goal)
        if place.shape[-1:] != self.goal.shape:
            raise InvalidArgumentError(f"y has to end with {len(self.goal)} dimensions, got {tuple(place.shape)}")
        place = place.expand(*self.batch_shape, *place.shape)
        return State(place, torch.zeros_like(place), place.new_ones(1))

    def step(self, now: State, dt: float) -> State:
        """Euler's method for y and z; the phase is exact."""
        force = self.outputs(self.features(now.s.expand(*now.y.shape[:-1], 1)), self.rows())
        step = dt / self.duration
        pull = ALPHA_Z * (ALPHA_Z / 4 * (self.goal + force - now.y) - now.z)
        return State(now.y + step * now.z, now.z + step * pull, now.s * math.exp(-ALPHA_S * step))

    def rollout(self, x0: Array, n_steps: int, dt: float) -> Rollout:
        """T times `step` from rest at `x0` `(*points, O)`; the features are reported as `torchds.rollout` does.

        The clock does not know the place, and place and velocity are a linear filter of the forcing term: a
        product with T × T numbers in place of a loop.

        Returns:
            A `Rollout` whose `x` is y `(*batch, *points, T+1, O)`, `v` is ẏ, and `inputs` the phase.

        Raises:
            InvalidArgumentError: starts of other dimensions, no steps, or a time step that is not positive.
        """
        n_steps = count("n_steps", n_steps, 1)
        dt = number("dt", dt, "positive and finite", lambda step: 0 < step < math.inf)
        y = self.begin(x0).y
        lead, n = y.shape[:-1], len(self.batch_shape)
        s = self._phases(n_steps, dt)
        features = self.features(s)  # (T, 2K)
        forces = features @ self.rows().mT  # (*batch, T, O)
        forces = forces.reshape(*self.batch_shape, *(1,) * (len(lead) - n), *forces.shape[-2:])
        free, filtered = self._filter(n_steps, dt)
        x = self.goal + free[:, None] * (y - self.goal).unsqueeze(-2) + filtered @ forces
        visited = features.expand(*lead, *features.shape)
        visits.report(self, visited)
        return _Phased(
            x=x,
            v=x.diff(dim=-2) / dt,
            visited=visited,
            dt=dt,
            resting=None,
            stiffness=None,
            reference=x,
            inputs=s.expand(*lead, *s.shape),
            plant=None,
        )

    @torch.no_grad()
    def response(self, n_steps: int, dt: float) -> Tensor:
        """Φ `(T, K)`: how far a unit of each weight moves the positions at the steps 1..T, in its dimension.

        The motion is linear in w, y(w) = y(0) + Φ w, so that this is its Jacobian everywhere.
        """
        return self._filter(n_steps, dt)[1][1:] @ self.features(self._phases(n_steps, dt))[:, ::2]

    def _phases(self, n_steps: int, dt: float) -> Tensor:
        """`(T, 1)` at the beginning of each step."""
        times = dt * torch.arange(n_steps, dtype=self.goal.dtype, device=self.goal.device).unsqueeze(-1)
        return torch.exp(-ALPHA_S / self.duration * times)

    def _filter(self, n_steps: int, dt: float) -> tuple[Tensor, Tensor]:
        """What is left of y − g after 0..T steps, `(T+1,)`, and how far the forces of all steps move it, `(T+1, T)`."""
        step = dt / self.duration
        turn = self.goal.new_tensor([[1.0, step], [-step * ALPHA_Z**2 / 4, 1 - step * ALPHA_Z]])
        powers = [torch.eye(2).to(turn)]
        for _ in range(n_steps):
            powers.append(turn @ powers[-1])
        left = torch.stack(powers)[:, 0]  # (T+1, 2), of y and of z
        late = torch.arange(n_steps + 1)[:, None] - torch.arange(n_steps) - 1
        moved = step * ALPHA_Z**2 / 4 * left[:, 1][late.clamp_min(0)]
        return left[:, 0], moved.masked_fill(late.to(moved.device) < 0, 0.0)
