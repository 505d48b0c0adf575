r"""Stability as one convex set of slopes: as a certificate, as a projection, and as a parametrisation (section 4.2).

A mixture of linear systems Σ_k h_k(x) (A_k x + b_k) with b_k = −A_k x* has its fixed point at the goal x*, and
V(x) = (x − x*)ᵀ P (x − x*) falls along every motion, whatever the gating, if all slopes are in the set

.. math:: \{A : P A + A^T P \preceq -2\, margin\, P\}, \qquad P \succ 0,\; margin > 0.

P = I is SEDS, any other P is P-QLF. In the coordinates z = C x with P = CᵀC the condition says that the symmetric part
of C A C⁻¹ is below −margin I; hence |x − x*|_P ≤ e^{−margin t} |x_0 − x*|_P: the margin is a rate of convergence [1/s].

Stability: stable.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torchds.arrays import Array, beside, like, number, real, shown
from torchds.errors import InvalidArgumentError

Policy = TypeVar("Policy", bound=nn.Module)

VERDICTS = ("proven", "not proven at this precision", "not stable")
ROUNDINGS = 100  # of the last digit, that sampling, averaging and storing slopes may add up to


class LinearExperts(Protocol):
    """What a certificate looks at: slopes `A` `(*batch, K, D, D)` and offsets `b` `(*batch, K, D)`."""

    @property
    def A(self) -> Tensor:
        """Slopes."""

    @property
    def b(self) -> Tensor:
        """Offsets."""


class Certificate(NamedTuple):
    """What proves that all motions end at the goal, for any gating.

    Attributes:
        eigenvalues: `(*batch, K)` the largest generalised eigenvalue of (P A_k + A_kᵀ P) / 2 against P [1/s].
        offset: `(*batch, K)` |b_k + A_k x*| [velocity unit].
        resolution: `(*batch, K)` how far rounding can have moved the eigenvalues [1/s].
        tied: `(*batch,)` True where every offset is zero up to round-off, so that the goal is a fixed point; or so small
            against the rate of its component that motions end at x* to half of its digits, |x − x*|_P ≤ √ε |x*|_P.
    """

    eigenvalues: Tensor
    offset: Tensor
    resolution: Tensor
    tied: Tensor

    @property
    def margin(self) -> Tensor:
        """The guaranteed rate of convergence `(*batch,)` [1/s]; negative where the condition is violated."""
        return -self.eigenvalues.amax(-1)

    @property
    def stable(self) -> Tensor:
        """`(*batch,)` True where it is proven: the goal is a fixed point and every eigenvalue is below −resolution."""
        return (self.eigenvalues < -self.resolution).all(-1) & self.tied

    @property
    def verdict(self) -> Any:
        """One of "proven", "not proven at this precision" and "not stable"; nested lists of them for a batch."""
        possible = (self.eigenvalues <= self.resolution).all(-1) & self.tied
        return _named(torch.where(self.stable, 0, torch.where(possible, 1, 2)).tolist())


def _named(kinds: Any) -> Any:
    return [_named(kind) for kind in kinds] if isinstance(kinds, list) else VERDICTS[kinds]


@torch.no_grad()
def certificate(policy: LinearExperts, goal: Array, P: Array | None = None) -> Certificate:
    """Check the condition of this module, in float64 whatever the policy is.

    A policy that fails may still be stable: the condition is sufficient, and it depends on P.

    Args:
        policy: a `GMRPolicy`, or anything with `A` and `b`.
        goal: `(D,)` or `(*batch, D)`, the goal x*.
        P: `(D, D)` or `(*batch, D, D)`; None for the identity.

    Raises:
        InvalidArgumentError: slopes that are not square, a goal of another dimension, or a P that is not symmetric
            positive definite.

    Example:
        >>> import torch, torchds
        >>> gate = torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None]
        >>> policy = torchds.GMRPolicy(*gate, A=torch.tensor([[[-1.0, 3.0], [0.0, -1.0]]]), b=torch.zeros(1, 2))
        >>> for P in (None, torch.diag(torch.tensor([1.0, 9.0]))):
        ...     proof = policy.certificate(torch.zeros(2), P)
        ...     print(f"{float(proof.margin):.2f} {proof.verdict}")
        -0.50 not stable
        0.50 proven
    """
    eps = torch.finfo(policy.A.dtype).eps
    A, b = policy.A.detach().double(), policy.b.detach().double()
    D = A.shape[-1]
    if A.shape[-2] != D:
        raise InvalidArgumentError(
            f"the slopes of a certificate have to be square, as many velocities as inputs, got ({A.shape[-2]}, {D})"
        )
    x_star = _checked_goal(goal, b[..., 0, :]).unsqueeze(-2)
    metric = _metric(P, A)
    eigenvalues = largest_eigenvalue(A, metric)
    blur = resolution(A, metric)
    pull = (A @ x_star.unsqueeze(-1)).squeeze(-1)
    offset = torch.linalg.vector_norm(b + pull, dim=-1)
    size = torch.linalg.vector_norm(b, dim=-1) + torch.linalg.matrix_norm(A) * torch.linalg.vector_norm(x_star, dim=-1)
    # b is kept in the policy's own precision, and what noise has made small has the rounding of what it was before. Along a
    # motion |x − x*|_P falls wherever it is above |offset|_P / rate, of all components the largest.
    near = _length(b + pull, metric) <= -math.sqrt(eps) * eigenvalues * _length(x_star, metric)
    tied = (offset <= 100 * eps * size) | near
    return Certificate(eigenvalues, offset, blur, tied.all(-1))


def resolution(A: Array, P: Array | None = None, dtype: torch.dtype = torch.float64) -> Tensor:
    r"""How far rounding to `dtype` can move what `largest_eigenvalue` gives, `(...)` [1/s].

    A rounded A differs by up to ε |A|, and in the coordinates of P that is seen :math:`\sqrt{cond P}` times as large. The
    factor covers the few operations that an update makes of it.

    Args:
        A: `(..., D, D)` slopes.
        P: `(..., D, D)`; None for the identity.
        dtype: in which A is kept.
    """
    A = _square("A", A)
    blur: Tensor = ROUNDINGS * torch.finfo(dtype).eps * torch.linalg.matrix_norm(A)
    if P is None:
        return blur
    values = torch.linalg.eigvalsh(beside("P", P, A, "(..., D, D)", last=2))
    spread: Tensor = (values[..., -1] / values[..., 0]).clamp_min(1.0).sqrt()
    return blur * spread


def largest_eigenvalue(A: Array, P: Array | None = None) -> Tensor:
    """The largest generalised eigenvalue of (P A + Aᵀ P) / 2 against P, `(...)` for `A` and `P` `(..., D, D)`.

    Negative means that A is in the set; minus it is the rate at which |x|_P is certain to fall. Differentiable.
    """
    eigenvalues: Tensor = torch.linalg.eigvalsh(_symmetric(_seen_by(P, _square("A", A))))
    return eigenvalues[..., -1]


def stable_matrices(factor: Array, skew: Array, P: Array | None = None, *, margin: float = 0.0) -> Tensor:
    r"""Slopes in the set from any tensors, A = P⁻¹ (−L Lᵀ + W − Wᵀ) − margin I.

    Since P A + Aᵀ P = −2 L Lᵀ − 2 margin P, this is the whole set: `stable_factors` is the inverse.

    Args:
        factor: `(..., D, D)` L.
        skew: `(..., D, D)` W.
        P: `(..., D, D)`; None for the identity.
        margin: the rate of convergence [1/s].

    Returns:
        `(..., D, D)`.
    """
    L = _square("factor", factor)
    W = beside("skew", skew, L, "(..., D, D)", last=2)
    M = W - W.mT - L @ L.mT
    M = M if P is None else torch.linalg.solve(beside("P", P, M, "(..., D, D)", last=2), M)
    return M - _margin(margin) * _identity_like(L)


def stable_factors(A: Array, P: Array | None = None, *, margin: float = 0.0) -> tuple[Tensor, Tensor]:
    """Factor (lower triangular) and skew (strictly upper) of slopes that lie in the set: `stable_matrices` inverted.

    Raises:
        InvalidArgumentError: slopes that do not have this margin; `project` moves them.
    """
    A = _square("A", A)
    M = A + _margin(margin) * _identity_like(A)
    M = M if P is None else beside("P", P, A, "(..., D, D)", last=2) @ M
    factor, info = torch.linalg.cholesky_ex(-_symmetric(M))
    if info.any():
        raise InvalidArgumentError(
            f"all slopes have to converge with a rate above {margin:g}, got {int((info != 0).sum())} of {info.numel()} "
            "that do not; move them into the set with project(A, P, margin=...), with a larger margin there than here"
        )
    return factor.contiguous(), ((M - M.mT) / 2).triu(1)


def project(A: Array, P: Array | None = None, *, margin: float | Array = 0.0) -> Tensor:
    """The slopes of the set nearest to A, in the Frobenius norm of C A C⁻¹ with P = CᵀC; A itself if it is in the set.

    The eigenvalues of the symmetric part are lowered to −margin where they are above; the rest of A stays.

    Args:
        A: `(..., D, D)`.
        P: `(..., D, D)`; None for the identity.
        margin: the rate of convergence that the result has at least, number or `(...)` [1/s].
    """
    A = _square("A", A)
    rate = beside("margin", margin, A[..., 0, 0], "a number or (...)", last=0).unsqueeze(-1)
    values, vectors = torch.linalg.eigh(_symmetric(_seen_by(P, A)))
    excess: Tensor = (vectors * (values + rate).clamp(min=0).unsqueeze(-2)) @ vectors.mT
    if P is not None:
        C = _root(like("P", P, A))
        excess = torch.linalg.solve_triangular(C, excess @ C, upper=True)
    return A - excess


def constrain(policy: Policy, goal: Array, P: Array | None = None, *, margin: float) -> Policy:
    """Let only free tensors of a policy be learned, from which its `A` and `b` follow as slopes and offsets of the set.

    Any optimizer, Adam or L-BFGS among them, then trains a policy that is stable at every step. `A` becomes
    `stable_matrices(factor, skew)` and `b` becomes −A x*, by `torch.nn.utils.parametrize`; the goal and P are kept as
    frozen parameters. `parametrize.remove_parametrizations(policy, name)` for "b", then for "A", makes a plain policy again.

    Args:
        policy: a `GMRPolicy`; changed in place. Slopes outside the set are moved into it (`project`), offsets tied to the goal.
        goal: `(D,)` or `(*batch, D)`, the goal x*.
        P: `(D, D)` or `(*batch, D, D)`; None for the identity.
        margin: the rate of convergence that every policy keeps [1/s], above zero.

    Returns:
        `policy`.

    Raises:
        InvalidArgumentError: a margin that is not above zero, or arguments that `certificate` refuses.

    Example:
        >>> import torch, torchds
        >>> mixture = torchds.GaussianMixture(torch.ones(1), torch.ones(1, 4), torch.eye(4)[None])
        >>> policy = torchds.GMRPolicy.from_mixture(mixture, input_dim=2)
        >>> _ = torchds.stability.constrain(policy, goal=torch.zeros(2), margin=0.1)
        >>> optim = torch.optim.Adam(policy.parameters())
        >>> torchds.rollout(policy, torch.ones(2), n_steps=10, dt=0.1).x.sum().backward()
        >>> optim.step()
        >>> bool(policy.certificate(torch.zeros(2)).stable)
        True
    """
    margin = number("margin", margin, "above 0 and finite", lambda rate: 0 < rate < math.inf)
    A: Tensor = policy.A.detach()  # type: ignore[operator]
    certificate(policy, goal, P)  # type: ignore[arg-type]  # for its checks
    batch, D = A.shape[:-3], A.shape[-1]
    metric = None if P is None else like("P", P, A).expand(*batch, D, D).clone()
    parametrize.register_parametrization(policy, "A", _Slopes(metric, margin))
    parametrize.register_parametrization(policy, "b", _Offsets(policy, like("goal", goal, A).expand(*batch, D).clone()))
    frozen = [policy.parametrizations.b.original]  # type: ignore[union-attr]
    frozen += [] if P is None else [policy.parametrizations.A.original2]  # type: ignore[union-attr]
    for parameter in frozen:
        parameter.requires_grad_(False)
    return policy


class _Slopes(nn.Module):
    """A from factor, skew and P; P travels with them so that it is copied and indexed with the policy."""

    SLACK = 1e-3  # relative: a policy on the boundary has no factor

    def __init__(self, P: Tensor | None, margin: float) -> None:
        super().__init__()
        self.margin = margin
        self._start = P

    def forward(self, factor: Tensor, skew: Tensor, P: Tensor | None = None) -> Tensor:
        return stable_matrices(factor, skew, None if P is None else P.unsqueeze(-3), margin=self.margin)

    def right_inverse(self, A: Tensor) -> tuple[Tensor, ...]:
        P = self._start
        metric = None if P is None else P.unsqueeze(-3)
        inside = project(A, metric, margin=self.margin * (1 + self.SLACK))
        return (*stable_factors(inside, metric, margin=self.margin), *([] if P is None else [P]))


class _Offsets(nn.Module):
    """b = −A x*, whose only tensor is the goal."""

    def __init__(self, policy: nn.Module, goal: Tensor) -> None:
        super().__init__()
        self._policy = (policy,)  # in a tuple, so that it does not become a submodule of its own part
        self._start = goal

    def forward(self, goal: Tensor) -> Tensor:
        A: Tensor = self._policy[0].A  # type: ignore[assignment]
        return -(A @ goal[..., None, :, None]).squeeze(-1)

    def right_inverse(self, b: Tensor) -> Tensor:
        return self._start


def _symmetric(M: Tensor) -> Tensor:
    return (M + M.mT) / 2


def _identity_like(M: Tensor) -> Tensor:
    return torch.eye(M.shape[-1], dtype=M.dtype, device=M.device)


def _length(x: Tensor, P: Tensor | None) -> Tensor:
    """|x|_P of vectors `(..., D)`."""
    length: Tensor = torch.linalg.vector_norm(x if P is None else (_root(P) @ x.unsqueeze(-1)).squeeze(-1), dim=-1)
    return length


def _root(P: Tensor) -> Tensor:
    """C, upper triangular, with P = CᵀC."""
    factor, info = torch.linalg.cholesky_ex(P)
    asymmetric = (P - P.mT).abs() > 1e-5 * P.abs().amax((-2, -1), keepdim=True)
    if info.any() or asymmetric.any() or not P.isfinite().all():
        raise InvalidArgumentError(f"P has to be symmetric positive definite, got {P.tolist()}; None stands for I")
    C: Tensor = factor.mT
    return C


def _seen_by(P: Array | None, A: Tensor) -> Tensor:
    """C A C⁻¹: the same motion in the coordinates z = C x, in which |x|_P is the length."""
    if P is None:
        return A
    C = _root(beside("P", P, A, "(..., D, D) as the slopes are", last=2))
    seen: Tensor = torch.linalg.solve_triangular(C, C @ A, upper=True, left=False)
    return seen


def _square(name: str, A: Array) -> Tensor:
    """Square matrices `(..., D, D)` of finite numbers."""
    A = real(name, A, "(..., D, D)")
    if A.shape[-2] != A.shape[-1]:
        raise InvalidArgumentError(f"{name} has to be (..., D, D), got shape {tuple(A.shape)}")
    return A


def _margin(margin: float) -> float:
    return number("margin", margin, "finite", math.isfinite)


def _metric(P: Array | None, A: Tensor) -> Tensor | None:
    """P `(*batch, 1, D, D)` of a policy with slopes `(*batch, K, D, D)`."""
    return None if P is None else beside("P", P, A[..., 0, :, :], "(D, D) or (*batch, D, D)", last=2).unsqueeze(-3)


def _checked_goal(goal: Array, b: Tensor) -> Tensor:
    """x* in the dtype of the offsets `b` `(*batch, D)`."""
    dim, x_star = b.shape[-1], like("goal", goal, b)
    if x_star.shape[-1:] != (dim,) or not x_star.isfinite().all():
        raise InvalidArgumentError(f"goal has to be finite and end with {dim} dimensions, got {shown(x_star.tolist())}")
    return beside("goal", x_star, b, "(D,) or (*batch, D)")
