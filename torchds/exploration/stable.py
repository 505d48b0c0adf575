"""Noise that keeps a stable policy stable (section 4.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn

from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration, name_parameters
from torchds.policy import GMRPolicy

Eta = Literal["closed", "stepped"]
Shrink = Literal["all", "direction", "none"]


class Stable(Exploration):
    r"""Noise under which every sample, hence every update, is as stable as the policy (Eq. 19-28).

    A policy is stable at the goal x* if, for every component,

    .. math:: b_k = -A_k x^*, \qquad P A_k + A_k^T P \preceq -2\, margin\, P

    with one P ≻ 0; P = I is SEDS, a learned P the weaker condition called P-QLF. In the coordinates Cᵀx with P = C Cᵀ both
    say that the symmetric part of A_k is negative definite. The raw noise E of A_k is split there into its symmetric and
    its antisymmetric part (Eq. 21-22). The latter cannot harm; the former is shrunk until A_k + ε_A satisfies the condition.
    The noise of b follows, ε_b = −ε_A x* (Eq. 23).

    The condition is convex, and an update is a convex combination of the samples (Eq. 28). That proof needs no more of the
    samples than that each of them satisfies the condition, so it holds for both ways to shrink.

    Args:
        policy: a stable one, with as many velocities as inputs. Stiffness parameters in the group get no noise.
        std: standard deviation of the raw noise of A [1/s], a number or a tensor that broadcasts with A; or another
            exploration that shapes it, such as `TrajectorySpace(..., goal=goal)`, which explores along the motion.
        goal: `(D,)` or `(*batch, D)` x*.
        P: `(D, D)` or `(*batch, D, D)`; None for the identity.
        eta: how the factor η of shrink="all" is found.

            * "closed": the largest in [0, 1], from an eigenvalue (see `shrinkage`).
            * "stepped": the first of 1, 0.9, ..., 0 that passes the check, as in the paper.
        shrink: what is shrunk.

            * "all": the symmetric part of the noise of A_k as a whole, by a factor η, as in the paper. A policy that is on
              the boundary in one direction is then hardly explored in any: half of the draws get η ≈ 0.
            * "direction": only what offends. The symmetric part of A_k + E is replaced by the nearest one that satisfies
              the condition: its eigenvalues above −margin become −margin.
            * "none": nothing. b stays tied to the goal, stability is not kept.
        margin: that the samples keep from the boundary [1/s], or what the policy has of it where that is less.

    Raises:
        InvalidArgumentError: a number out of range, an unknown name, shapes that do not fit, a P that is not positive
            definite; from the optimizer, a group without A and b, or a policy that is not stable at the goal.

    Example:
        >>> import torch, torchds
        >>> A = torch.tensor([[[-1.0, 2.0], [-2.0, -0.1]]])
        >>> policy = torchds.GMRPolicy(torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None], A, torch.zeros(1, 2))
        >>> noise = torchds.exploration.Stable(policy, std=0.5, goal=torch.zeros(2))
        >>> normals = [torch.randn(1000, *p.shape) for p in policy.parameters()]
        >>> tried = policy.A + noise(list(policy.parameters()), normals)[0]
        >>> bool((torch.linalg.eigvalsh(tried + tried.mT) < 0).all())
        True
    """

    def __init__(
        self,
        policy: GMRPolicy,
        std: float | Tensor | Exploration,
        goal: Tensor,
        P: Tensor | None = None,
        *,
        eta: Eta = "closed",
        shrink: Shrink = "all",
        margin: float = 1e-3,
    ) -> None:
        D = policy.input_dim
        for name, value, allowed in (("eta", eta, get_args(Eta)), ("shrink", shrink, get_args(Shrink))):
            if value not in allowed:
                raise InvalidArgumentError(f"{name} has to be one of {', '.join(map(repr, allowed))}, got {value!r}")
        if not 0 < margin < float("inf"):
            raise InvalidArgumentError(f"margin has to be finite and positive, got {margin}")
        if not isinstance(std, Exploration):
            size = torch.as_tensor(std)
            if not size.isfinite().all() or (size < 0).any():
                raise InvalidArgumentError(f"std has to be finite and ≥ 0, got {std}")
        if policy.output_dim != D:
            raise InvalidArgumentError(f"stability needs as many velocities as inputs, got {policy.output_dim} and {D}")
        if goal.shape[-1:] != (D,):
            raise InvalidArgumentError(f"goal has to end with the policy's {D} inputs, got {tuple(goal.shape)}")
        if P is not None and (
            P.shape[-2:] != (D, D) or not torch.equal(P, P.mT) or torch.linalg.cholesky_ex(P).info.any()
        ):
            raise InvalidArgumentError(f"P has to be symmetric, positive definite and (*batch, {D}, {D}), got {P}")
        self.policy = policy
        self.std = std
        self.goal = goal
        self.P = P
        self.eta = eta
        self.shrink = shrink
        self.margin = margin

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse a group without A and b, and a policy that is not stable at the goal."""
        names = name_parameters(self.policy, parameters, type(self).__name__)
        if missing := {"A", "b"} - set(names):
            raise InvalidArgumentError(f"Stable ties b to A; {sorted(missing)} of the policy is not in the group")
        if isinstance(self.std, Exploration):
            self.std.check(parameters)
        A, b = self.policy.A.detach(), self.policy.b.detach()
        apart = (b - self._tied(A)).abs().amax()
        if apart > 1e3 * torch.finfo(b.dtype).eps * (1.0 + (A.abs() @ self._column().abs()).amax()):
            raise InvalidArgumentError(
                f"b differs from −A x* by up to {apart:.2g}: the policy does not rest at the goal; fit one that does, with "
                "torchds.fit_stable, or give the goal of its fit"
            )
        if self.shrink != "none" and not (largest := self.largest_eigenvalues().amax()) < 0:
            raise InvalidArgumentError(
                f"the policy is not stable: the symmetric part of its A has an eigenvalue {largest:.3g} where all have to be "
                "negative; fit one with torchds.fit_stable, give the P of its fit, or use shrink='none'"
            )

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """ε_A, ε_b, and zero for all other parameters."""
        names = name_parameters(self.policy, parameters, type(self).__name__)
        drawn = dict(zip(names, normals, strict=True))
        if isinstance(self.std, Exploration):
            raw = dict(zip(names, self.std(parameters, normals), strict=True))["A"]
        else:
            raw = drawn["A"] * torch.as_tensor(self.std, dtype=drawn["A"].dtype, device=drawn["A"].device)
        noise = {"A": self.stabilise(raw)}
        noise["b"] = self._tied(noise["A"])
        return [noise[name] if name in noise else torch.zeros_like(drawn[name]) for name in names]

    @torch.no_grad()
    def stabilise(self, raw: Tensor) -> Tensor:
        """The part of the noise `raw` `(..., *batch, K, D, D)` of A that keeps the policy stable (Eq. 22)."""
        if self.shrink == "none":
            return raw
        A = self.policy.A
        own = -self.largest_eigenvalues()
        margin = own.clamp(max=self.margin)
        stable_part, noise_part = _symmetric(A, self._metric()), _symmetric(raw, self._metric())
        if self.shrink == "direction":
            values, vectors = torch.linalg.eigh(stable_part + noise_part)
            excess = (values + margin.unsqueeze(-1)).clamp_min(0.0)
            cut = (vectors * excess.unsqueeze(-2)) @ vectors.mT
        else:
            eta = self.shrinkage(stable_part, noise_part, margin=margin)
            if self.eta == "stepped":
                eta = (10 * eta).floor() / 10
            cut = (1.0 - eta)[..., None, None] * noise_part
        return raw - _back(cut, self._metric())

    @torch.no_grad()
    def largest_eigenvalues(self) -> Tensor:
        """Per component `(*batch, K)` the largest eigenvalue of the symmetric part of A, negative for a stable policy.

        With P, it is the largest λ with P A + Aᵀ P ⪯ 2 λ P.
        """
        return torch.linalg.eigvalsh(_symmetric(self.policy.A, self._metric()))[..., -1]

    def scalars(self) -> dict[str, float]:
        """The certificate of the present policies: their largest eigenvalue of all."""
        return {"stability/largest_eigenvalue": float(self.largest_eigenvalues().amax())}

    @staticmethod
    @torch.no_grad()
    def shrinkage(A: Tensor, S_noise: Tensor, P: Tensor | None = None, margin: float | Tensor = 0.0) -> Tensor:
        r"""The largest η in [0, 1] for which A + η S_noise is stable with the margin, in closed form.

        With N and S the symmetric parts of A and S_noise in the coordinates of P, and W = −N − margin I,

        .. math:: η = \min(1, 1/λ_{max}(W^{-1/2} S W^{-1/2})).

        Args:
            A: `(..., D, D)`, with any antisymmetric part.
            S_noise: `(..., D, D)`; both broadcast.
            P: `(..., D, D)`, None for the identity.
            margin: number or `(...)`.

        Returns:
            `(...)`; zero where A itself does not have the margin.
        """
        N, S = _symmetric(A, P), _symmetric(S_noise, P)
        margin = torch.as_tensor(margin, dtype=N.dtype, device=N.device)
        values, vectors = torch.linalg.eigh(N)
        room = -values - margin.unsqueeze(-1)
        tiny = torch.finfo(N.dtype).eps * values.abs().amax(-1, keepdim=True) + torch.finfo(N.dtype).tiny
        root = vectors * room.clamp_min(tiny).rsqrt().unsqueeze(-2)  # W^{-1} = root rootᵀ
        steepest = torch.linalg.eigvalsh(root.mT @ S @ root)[..., -1]
        eta = torch.where(steepest > 1.0, 1.0 / steepest, 1.0)
        return torch.where((room >= -tiny).all(-1), eta, 0.0)

    def state_dict(self) -> dict[str, Any]:
        """That of the exploration behind the raw noise."""
        return {"raw": self.std.state_dict()} if isinstance(self.std, Exploration) else {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take over what `state_dict` gave."""
        if isinstance(self.std, Exploration):
            self.std.load_state_dict(state["raw"])

    def _metric(self) -> Tensor | None:
        return None if self.P is None else self.P.unsqueeze(-3)  # the same for all components

    def _column(self) -> Tensor:
        return self.goal[..., None, :, None]  # (*batch, 1, D, 1)

    def _tied(self, A: Tensor) -> Tensor:
        return -(A @ self._column()).squeeze(-1)


def _symmetric(A: Tensor, P: Tensor | None) -> Tensor:
    """The symmetric part of A in the coordinates Cᵀx, P = C Cᵀ: ½ (CᵀA C⁻ᵀ + its transpose)."""
    if P is not None:
        C = torch.linalg.cholesky(P)
        A = torch.linalg.solve_triangular(C, A.mT @ C, upper=False).mT
    return 0.5 * (A + A.mT)


def _back(A: Tensor, P: Tensor | None) -> Tensor:
    """From the coordinates Cᵀx: C⁻ᵀ A Cᵀ."""
    if P is None:
        return A
    C = torch.linalg.cholesky(P)
    return torch.linalg.solve_triangular(C.mT, A @ C.mT, upper=True)
