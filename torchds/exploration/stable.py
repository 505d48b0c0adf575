"""Noise that keeps a stable policy stable (section 4.2).

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn

from torchds.arrays import Array, beside, number, real, shown
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration, name_parameters
from torchds.policy import GMRPolicy
from torchds.stability import largest_eigenvalue, project, resolution

Eta = Literal["closed", "stepped"]
Shrink = Literal["all", "direction", "none"]

SLACK = 1e-6  # relative


class Stable(Exploration):
    r"""Noise under which every sample, hence every update, is as stable as the policy (Eq. 19-28).

    A policy is stable at the goal x* if, for every component,

    .. math:: b_k = -A_k x^*, \qquad P A_k + A_k^T P \preceq -2\, margin\, P

    with one P ≻ 0; P = I is SEDS, a learned P the weaker condition P-QLF (`torchds.stability`). The raw noise E of A_k is
    split into a symmetric part ½ (E + P⁻¹EᵀP) and the rest, which is antisymmetric for P = I (Eq. 21-22). The rest cannot
    harm; the symmetric part is shrunk until A_k + ε_A satisfies the condition. b follows, ε_b = −ε_A x* (Eq. 23).

    The condition is convex, and an update is a convex combination of the samples (Eq. 28). That proof needs no more of the
    samples than that each of them satisfies the condition, so it holds for both ways to shrink.

    Args:
        policy: a stable one, with as many velocities as inputs. Stiffness parameters in the group get no noise; A and b
            have to be both free or both frozen (requires_grad).
        raw: shapes the raw noise E of A [1/s]; of what it gives to other parameters nothing is used. `Gaussian(0.5)` for
            one standard deviation, `TrajectorySpace(..., goal=goal)` to explore along the motion.
        goal: `(D,)` or `(*batch, D)` x*.
        P: `(D, D)` or `(*batch, D, D)`; None for the identity.
        eta: how the factor η of shrink="all" is found.

            * "closed": the largest in [0, 1], from an eigenvalue (see `shrinkage`).
            * "stepped": the first of 1, 0.9, ..., 0 that passes the check, as in the paper.
        shrink: what is shrunk.

            * "all": the symmetric part of the noise of A_k as a whole, by a factor η, as in the paper. A policy that is on
              the boundary in one direction is then hardly explored in any: half of the draws get η ≈ 0.
            * "direction": only what offends. A_k + E is replaced by the nearest slopes that satisfy the condition, with
              the eigenvalues of the symmetric part that are above −margin lowered to it (`stability.project`). Noise that
              is large against the room has a mean then, into the set.
            * "none": nothing. b stays tied to the goal, stability is not kept.
        margin: rate of convergence that the samples keep [1/s]. A component whose own rate is lower keeps the rate that
            it has.

    Raises:
        InvalidArgumentError: a number out of range, an unknown name, shapes that do not fit, a P that is not positive
            definite; from the optimizer, a group without A and b, or a policy that is not stable at the goal.

    Example:
        >>> import torch, torchds
        >>> A = torch.tensor([[[-1.0, 2.0], [-2.0, -0.1]]])
        >>> policy = torchds.GMRPolicy(torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None], A, torch.zeros(1, 2))
        >>> noise = torchds.exploration.Stable(policy, torchds.exploration.Gaussian(0.5), goal=torch.zeros(2))
        >>> normals = [torch.randn(1000, *p.shape) for p in policy.parameters()]
        >>> tried = policy.A + noise(list(policy.parameters()), normals)[0]
        >>> bool((torch.linalg.eigvalsh(tried + tried.mT) < 0).all())
        True
    """

    def __init__(
        self,
        policy: GMRPolicy,
        raw: Exploration,
        goal: Array,
        P: Array | None = None,
        *,
        eta: Eta = "closed",
        shrink: Shrink = "all",
        margin: float = 1e-3,
    ) -> None:
        for name, value, allowed in (("eta", eta, get_args(Eta)), ("shrink", shrink, get_args(Shrink))):
            if value not in allowed:
                raise InvalidArgumentError(f"{name} has to be one of {', '.join(map(repr, allowed))}, got {value!r}")
        margin = number("margin", margin, "finite and positive", lambda rate: 0 < rate < math.inf)
        if not isinstance(raw, Exploration):
            raise InvalidArgumentError(f"raw has to be an exploration, got {raw!r}; use Gaussian({raw!r}) for a number")
        policy.certificate(goal, P)  # refuses shapes and a P that do not fit
        self.policy = policy
        self.raw = raw
        self.goal: Tensor = real("goal", goal)
        self.P: Tensor | None = None if P is None else real("P", P)
        self.eta = eta
        self.shrink = shrink
        self.margin = margin

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse a group without A and b, and a policy that is not stable at the goal."""
        names = name_parameters(self.policy, parameters, type(self).__name__)
        if missing := {"A", "b"} - set(names):
            raise InvalidArgumentError(f"Stable ties b to A; {sorted(missing)} of the policy is not in the group")
        self._check_tie()
        self.raw.check(parameters)
        certificate = self.policy.certificate(self.goal, self.P)
        A, b = self.policy.A.detach(), self.policy.b.detach()
        size = b.abs().amax() + A.abs().amax() * self.goal.to(A).abs().amax()
        apart = certificate.offset
        if not (certificate.tied | (apart <= 1e3 * torch.finfo(size.dtype).eps * size).all(-1)).all():
            raise InvalidArgumentError(
                f"b differs from −A x* by up to {apart.amax():.2g}: the policy does not rest at the goal {self.goal.tolist()}; "
                "give the goal of its fit, or fit one that rests there with torchds.fit_stable(..., goal=goal)"
            )
        if self.shrink == "none":
            return
        if not (largest := -certificate.margin.amin()) < 0:
            raise InvalidArgumentError(
                f"the policy is not stable: {largest:.3g} is the largest eigenvalue of the symmetric part of A, and all have "
                "to be negative; give the P of its fit, fit one with torchds.fit_stable, or use shrink='none'"
            )
        blur = resolution(A.double(), None if self.P is None else self.P.double().unsqueeze(-3), A.dtype)
        if (certificate.eigenvalues >= -blur).any():
            raise InvalidArgumentError(
                f"the policy's margin of {-largest:.3g} 1/s is below the {blur.amax():.3g} that {A.dtype} resolves: "
                "no noise could be held to it; learn in float64 (policy.double()), or fit with a larger margin"
            )

    def _check_tie(self) -> None:
        if self.policy.A.requires_grad != self.policy.b.requires_grad:
            raise InvalidArgumentError(
                "Stable ties b to A: both have to be free or both frozen, got requires_grad = "
                f"{self.policy.A.requires_grad} of A and {self.policy.b.requires_grad} of b; set both"
            )

    @property
    def needs_convex_update(self) -> bool:  # type: ignore[override]
        """Whether stability is kept: that of the samples is an update's if it is a convex combination of them (Eq. 28)."""
        return self.shrink != "none"

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """ε_A, ε_b, and zero for all other parameters."""
        self._check_tie()
        names = name_parameters(self.policy, parameters, type(self).__name__)
        raw = self.raw(parameters, normals)[names.index("A")]
        A, b = self.policy.A.detach(), self.policy.b.detach()
        noise = {"A": self.stabilise(raw)}
        # Not only −ε_A x*: round-off of b + A x* would add up over many updates, and here it is taken back.
        noise["b"] = self._tied(noise["A"]) + (self._tied(A) - b)
        return [noise[name] if name in noise else torch.zeros_like(z) for name, z in zip(names, normals, strict=True)]

    def measure(self, parameters: Sequence[nn.Parameter], changes: Sequence[Tensor]) -> list[Tensor]:
        """That of the exploration behind the raw noise."""
        return self.raw.measure(parameters, changes)

    @torch.no_grad()
    def stabilise(self, raw: Tensor) -> Tensor:
        """The part of the noise `raw` `(..., *batch, K, D, D)` of A that keeps the policy stable (Eq. 22).

        Found in float64; samples keep as much of the margin as rounding them to the policy's precision may take.
        """
        if self.shrink == "none":
            return raw
        A, drawn = self.policy.A.detach().double(), raw.double()
        P = None if self.P is None else self.P.to(drawn).unsqueeze(-3)
        own = -largest_eigenvalue(A, P)  # (*batch, K)
        blur = resolution(A, P, raw.dtype)
        # A policy on its own boundary would leave no room to the last digit, and round-off would decide.
        margin = torch.minimum((1 - SLACK) * own, (2 * blur).clamp_min(self.margin))
        noise = self._inside(A, drawn, P, margin)
        # What is larger than the slopes is rounded in larger steps.
        coarse = resolution(A + noise, P, raw.dtype) > margin
        safe = (own > blur) & ~coarse
        return torch.where(safe[..., None, None], noise, 0.0).to(raw)

    def _inside(self, A: Tensor, raw: Tensor, P: Tensor | None, margin: Tensor) -> Tensor:
        """The part of `raw` with which A keeps the `margin` `(*batch, K)`."""
        if self.shrink == "direction":
            tried = A + raw
            return raw + (project(tried, P, margin=margin) - tried)
        eta = self.shrinkage(A, raw, P, margin=margin)
        if self.eta == "stepped":
            eta = (10 * eta).floor() / 10
        turned = raw.mT if P is None else torch.linalg.solve(P, raw.mT @ P)
        return raw - 0.5 * (1.0 - eta)[..., None, None] * (raw + turned)

    def scalars(self) -> dict[str, float]:
        """The certificate of the present policies: the largest eigenvalue of all of them, negative if all are stable."""
        return {"stability/largest_eigenvalue": -float(self.policy.certificate(self.goal, self.P).margin.amin())}

    @staticmethod
    @torch.no_grad()
    def shrinkage(A: Array, S_noise: Array, P: Array | None = None, *, margin: float | Array = 0.0) -> Tensor:
        r"""The largest η in [0, 1] for which A + η S_noise is stable with the margin, in closed form.

        With W = −½ (P A + Aᵀ P) − margin P ≻ 0 and S = ½ (P S_noise + S_noiseᵀ P),

        .. math:: η = \min(1, 1/λ_{max}), \qquad S u = λ W u.

        Args:
            A: `(..., D, D)`, symmetric or not.
            S_noise: `(..., D, D)`, symmetric or not; both broadcast.
            P: `(..., D, D)`, None for the identity.
            margin: number or `(...)` [1/s].

        Returns:
            `(...)`; zero where A itself does not have the margin.
        """
        A = real("A", A, "(..., D, D)")
        E = beside("S_noise", S_noise, A, "(..., D, D)", last=2)
        eye = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)
        lever = eye if P is None else beside("P", P, A, "(..., D, D)", last=2)
        rate = beside("margin", margin, A[..., 0, 0], "a number or (...)", last=0)[..., None, None]
        N, S = (0.5 * (lever @ M + M.mT @ lever) for M in (A, E))
        values, vectors = torch.linalg.eigh(-N - rate * lever)
        tiny = torch.finfo(A.dtype).eps * torch.linalg.matrix_norm(N).unsqueeze(-1) + torch.finfo(A.dtype).tiny
        root = vectors * values.clamp_min(tiny).rsqrt().unsqueeze(-2)  # W⁻¹ = root rootᵀ
        steepest = torch.linalg.eigvalsh(root.mT @ S @ root)[..., -1]
        eta = torch.where(steepest > 1.0, 1.0 / steepest, 1.0)
        return torch.where((values >= -tiny).all(-1), eta, 0.0)

    def state_dict(self) -> dict[str, Any]:
        """That of the exploration behind the raw noise."""
        return {"raw": self.raw.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take over what `state_dict` gave."""
        if set(state) != {"raw"} or not isinstance(state["raw"], Mapping):
            raise InvalidArgumentError(
                f"a state of Stable is {{'raw': state of {type(self.raw).__name__}}}, got {shown(state)}"
            )
        self.raw.load_state_dict(state["raw"])

    def _tied(self, A: Tensor) -> Tensor:
        return -(A @ self.goal.to(A)[..., None, :, None]).squeeze(-1)
