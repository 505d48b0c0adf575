"""The policy: a mixture of linear dynamical systems with a frozen gating (Eq. 1-13, 34, 42-45).

Stability: stable.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn import functional as F

from torchds import stability
from torchds.arrays import Array, beside, broadcast_shape, like, of_one_dtype
from torchds.errors import InvalidArgumentError
from torchds.kernels.fused import Field
from torchds.mixture import GaussianMixture
from torchds.parameters import ExpertParameters, arrange

if TYPE_CHECKING:
    from torchds.demonstrations import Demonstrations


# Dimensions of each buffer behind the batch.
_CORE = {"priors": 1, "means": 2, "factors": 3, "_center": 1, "_offset": 1, "_log_scale": 1}
_CORE |= {"initial_A": 3, "initial_b": 2, "initial_stiffness_A": 3, "initial_stiffness_b": 2}
_OUTPUTS = ("gating", "_whitened", "_at_points", "features", "outputs")  # methods that compiled code stands for


class GMRPolicy(ExpertParameters):
    r"""A time-invariant dynamical system from Gaussian mixture regression.

    .. math:: [\dot x; s] = \sum_k h_k(x) (A_k x + b_k), \qquad h_k(x) = \frac{π_k N(x; μ_k, Σ_k)}{\sum_i π_i N(x; μ_i, Σ_i)}

    with the velocity rows first and Q stiffness rows after them (Eq. 34). The gating h is frozen: priors, centres and
    input covariances are buffers. Learnable are `A`, `b` and, for Q > 0, `stiffness_A`, `stiffness_b`. All four may
    carry leading batch dimensions, the `batch_shape`: one module then holds many policies over one gating.

    Args:
        priors: `(K,)` π_k. All three may have a batch of their own in front, with which that of the parameters ends:
            policies over different gatings, as a batch of fits to different motions gives them.
        means: `(K, D)` centres μ_k of the inputs.
        covariances: `(K, D, D)` input covariances Σ_k.
        A: `(*batch, K, O, D)` slopes of the velocity.
        b: `(*batch, K, O)` offsets of the velocity.
        stiffness_A: `(*batch, K, Q, D)` slopes of the stiffness; None for a policy without stiffness.
        stiffness_b: `(*batch, K, Q)` offsets of the stiffness.

    The values given here are kept in the buffers `initial_A`, ... as the demonstrated policy that the control cost is
    measured from (Eq. 12-13). Most users call `from_demonstrations` or `from_mixture`.

    Raises:
        InvalidArgumentError: shapes that do not fit together.
        DegenerateMixtureError: a gating that is no Gaussian mixture.

    Example:
        >>> import torch, torchds
        >>> mixture = torchds.GaussianMixture(torch.ones(1), torch.zeros(1, 4), torch.eye(4)[None])
        >>> policy = torchds.GMRPolicy.from_mixture(mixture, input_dim=2)
        >>> policy(torch.tensor([1.0, 2.0]))
        tensor([0., 0.], grad_fn=<SqueezeBackward1>)
    """

    priors: Tensor
    means: Tensor
    factors: Tensor
    _center: Tensor
    _offset: Tensor
    _log_scale: Tensor

    def __init__(
        self,
        priors: Array,
        means: Array,
        covariances: Array,
        A: Array,
        b: Array,
        stiffness_A: Array | None = None,
        stiffness_b: Array | None = None,
    ) -> None:
        given: dict[str, Any] = {"priors": priors, "means": means, "covariances": covariances, "A": A, "b": b}
        given |= {"stiffness_A": stiffness_A, "stiffness_b": stiffness_b}
        stiffness_too = ("stiffness_A", "stiffness_b")
        tensors = of_one_dtype(given, optional=stiffness_too, finite=("A", "b", *stiffness_too))
        pi, mu, Sigma, A_v, b_v, A_s, b_s = tensors
        gate = GaussianMixture(pi, mu, Sigma)
        K, D = mu.shape[-2:]
        if (A_s is None) != (b_s is None):
            raise InvalidArgumentError("stiffness_A and stiffness_b come together; got only one of them")
        if A_s is None:
            A_s, b_s = A_v.new_zeros(*A_v.shape[:-2], 0, D), b_v.new_zeros(*b_v.shape[:-1], 0)
        for slopes, offsets in ((A_v, b_v), (A_s, b_s)):
            if slopes.ndim < 3 or slopes.shape[-3::2] != (K, D) or offsets.shape != slopes.shape[:-1]:
                raise InvalidArgumentError(
                    f"with {K} components of {D} inputs, slopes have to be (*batch, {K}, O, {D}) and offsets "
                    f"(*batch, {K}, O); got {tuple(slopes.shape)} and {tuple(offsets.shape)}"
                )
        try:
            lead, own = broadcast_shape(A_v.shape[:-3], A_s.shape[:-3]), gate.batch_shape
        except RuntimeError:
            raise InvalidArgumentError(
                f"A and stiffness_A need one batch, got {tuple(A_v.shape[:-3])} and {tuple(A_s.shape[:-3])}"
            ) from None
        A_v, A_s = (slopes.expand(*lead, *slopes.shape[-3:]) for slopes in (A_v, A_s))
        b_v, b_s = (offsets.expand(*lead, *offsets.shape[-2:]) for offsets in (b_v, b_s))
        if lead[len(lead) - len(own) :] != own:
            raise InvalidArgumentError(f"a gating of batch {own} needs parameters whose batch ends with it, got {lead}")
        super().__init__(A_v, b_v, A_s, b_s)
        # Σ⁻¹ = WᵀW with W = L⁻¹, so that |W(x − μ)| is the Mahalanobis distance.
        identity = torch.eye(D, dtype=mu.dtype, device=mu.device).expand_as(Sigma)
        factors = torch.linalg.solve_triangular(torch.linalg.cholesky(Sigma), identity, upper=False)
        center = mu.mean(-2)  # distances are taken from here first: float32 keeps its digits far from the origin
        self.register_buffer("priors", pi.detach().clone())
        self.register_buffer("means", mu.detach().clone())
        self.register_buffer("factors", factors.detach())
        self.register_buffer("_center", center.detach())
        offset = -(factors @ (mu - center.unsqueeze(-2)).unsqueeze(-1)).flatten(-3)
        self.register_buffer("_offset", offset.detach())
        log_scale = pi.log() + factors.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        self.register_buffer("_log_scale", log_scale.detach())

    # ------------------------------------------------------------------ construction

    @classmethod
    def from_mixture(
        cls,
        mixture: GaussianMixture,
        input_dim: int,
        stiffness_dim: int = 0,
        stiffness: float | Array | None = None,
    ) -> GMRPolicy:
        """Condition a joint mixture over [x, v(, s)] on x (Eq. 1-3, 34).

        Args:
            mixture: over D + O (+ Q) variables.
            input_dim: D; the rest are outputs. O may be larger than D (Eq. 36: position in, position and angle rates
                out).
            stiffness_dim: Q, the number of stiffness outputs.
            stiffness: a constant s⁰ [N/m], number or `(Q,)`, for stiffness rows A_s = 0, b_s = s⁰ beside a mixture
                without stiffness variables; None if the last Q variables of the mixture are the stiffness.

        Raises:
            InvalidArgumentError: dimensions that the mixture does not have, or a stiffness without stiffness_dim.
        """
        K, F_ = mixture.means.shape[-2:]
        n_outputs = F_ - input_dim - (stiffness_dim if stiffness is None else 0)
        if stiffness_dim < 0 or n_outputs < 1:
            raise InvalidArgumentError(
                f"a mixture of {F_} variables cannot give input_dim={input_dim}, stiffness_dim={stiffness_dim} and at "
                "least one velocity; pass stiffness=s0 for a constant stiffness that is not part of the mixture"
            )
        if stiffness is not None and stiffness_dim == 0:
            raise InvalidArgumentError(f"stiffness={stiffness} needs stiffness_dim ≥ 1, got 0")
        A, b = mixture.experts(input_dim)
        A, stiffness_A = A[..., :n_outputs, :], A[..., n_outputs:, :]
        b, stiffness_b = b[..., :n_outputs], b[..., n_outputs:]
        if stiffness is not None:
            stiffness_A = A.new_zeros(K, stiffness_dim, input_dim)
            words = f"a number or ({stiffness_dim},) for {stiffness_dim=}"
            rows = beside("stiffness", stiffness, b.new_empty(stiffness_dim), words, last=0)
            stiffness_b = rows.expand(K, stiffness_dim)
        gate = mixture.marginal(0, input_dim)
        return cls(gate.priors, gate.means, gate.covariances, A, b, stiffness_A, stiffness_b)

    @classmethod
    def from_demonstrations(
        cls,
        demonstrations: Demonstrations,
        n_components: Any = 4,
        *,
        input_dim: int | None = None,
        stiffness: float | Array | None = None,
        stiffness_dim: int = 0,
        **fit: Any,
    ) -> GMRPolicy:
        """Fit a mixture by EM and condition it: lines 2-8 of Algorithm 1.

        Args:
            demonstrations: with stiffness columns, these become stiffness outputs.
            n_components: K, or "bic".
            input_dim: how many of the positions are inputs; None for all.
            stiffness: a constant s⁰ [N/m] where no stiffness was demonstrated (see `from_mixture`).
            stiffness_dim: Q for a constant stiffness.
            **fit: options of `GaussianMixture.fit`.

        Raises:
            InvalidArgumentError: a constant stiffness beside a demonstrated one, or a stiffness_dim without either.
            DegenerateMixtureError: see `GaussianMixture.fit`.
        """
        demonstrated = demonstrations[0].stiffness
        if demonstrated is not None and stiffness is not None:
            raise InvalidArgumentError(f"these demonstrations carry stiffness; leave out stiffness={stiffness}")
        if demonstrated is None and stiffness is None and stiffness_dim:
            raise InvalidArgumentError(
                f"these demonstrations carry no stiffness; stiffness_dim={stiffness_dim} needs stiffness=s0 too"
            )
        mixture = GaussianMixture.fit(demonstrations, n_components, input_dim=input_dim, **fit)
        if demonstrated is not None:
            stiffness_dim = demonstrated.shape[-1]
        return cls.from_mixture(mixture, input_dim or demonstrations.dim, stiffness_dim, stiffness)

    def expand(self, *batch_shape: int) -> GMRPolicy:
        """A new policy with `batch_shape` independent copies of this one's parameters, e.g. 20 learning runs."""
        return self._with({name: p.expand(*batch_shape, *p.shape) for name, p in self.named_parameters()})

    def __getitem__(self, index: int | slice | Tensor) -> GMRPolicy:
        """A new policy with the selected part of the batch."""
        n = len(self.batch_shape)
        if not n:
            raise InvalidArgumentError("this policy has no batch to index; make one with expand(n)")
        policy = self._with({name: p[index] for name, p in self.named_parameters()})
        for name, value in self.named_buffers(recurse=False):
            if (
                value.ndim - _CORE.get(name, value.ndim) == n
            ):  # others are shared by the whole batch, or by its first dimension
                setattr(policy, name, value[index].clone())
        policy.info = self.info.part(index, n)
        return policy

    def _with(self, values: dict[str, Tensor]) -> GMRPolicy:
        policy = copy.deepcopy(self)
        for name, value in values.items():
            policy.get_parameter(name).data = value.detach().clone()
        return policy

    # ------------------------------------------------------------------ shapes

    @property
    def covariances(self) -> Tensor:
        """`(K, D, D)` input covariances Σ_k of the gating."""
        identity = torch.eye(self.input_dim, dtype=self.factors.dtype, device=self.factors.device)
        L: Tensor = torch.linalg.solve_triangular(self.factors, identity.expand_as(self.factors), upper=False)
        return L @ L.mT

    def extra_repr(self) -> str:
        """Summarise the shapes."""
        sizes = f"K={self.n_components}, D={self.input_dim}, O={self.output_dim}, Q={self.stiffness_dim}"
        return f"{sizes}, batch_shape={self.batch_shape}"

    # ------------------------------------------------------------------ evaluation

    def gating(self, x: Array) -> Tensor:
        """h_k(x) of Eq. 2, `(..., K)` for `x` `(..., D)`: sums to one, arbitrarily far from the data too.

        Raises:
            InvalidArgumentError: `x` does not end with the D inputs.
        """
        x = self._checked(x)
        z = self._whitened(x)
        limit = torch.finfo(z.dtype).max ** 0.5 / (4 * self.input_dim)  # squares stay finite
        squares = torch.unflatten(z.clamp(-limit, limit).square(), -1, (self.n_components, self.input_dim)).sum(-1)
        return torch.softmax(self._at_points(self._log_scale, 1, x) - 0.5 * squares, -1)

    def _checked(self, x: Array) -> Tensor:
        """States `(..., D)` of any type of numbers, in the dtype of the policy."""
        x = like("x", x, self.means)
        if x.shape[-1:] != (self.input_dim,):
            raise InvalidArgumentError(f"x has to end with the policy's {self.input_dim} inputs, got {tuple(x.shape)}")
        return x

    def _whitened(self, x: Tensor) -> Tensor:
        """L_k⁻¹ (x − μ_k) for all components, `(..., K D)`."""
        W = self.factors.flatten(-3, -2)
        far = torch.finfo(W.dtype).max ** 0.5 / (4 * self.input_dim)  # beyond, a product is infinity minus infinity
        if W.ndim == 2:
            return F.linear((x - self._center).clamp(-far, far), W, self._offset)
        centered = (x - self._at_points(self._center, 1, x)).clamp(-far, far)
        offset = self._at_points(self._offset, 1, x)
        n_points = x.ndim - 1 - len(self.batch_shape)
        if n_points == 0:
            return (W @ centered.unsqueeze(-1)).squeeze(-1) + offset
        return centered @ W.reshape(*W.shape[:-2], *(1,) * (n_points - 1), *W.shape[-2:]).mT + offset

    def _at_points(self, buffer: Tensor, core: int, x: Tensor) -> Tensor:
        """A buffer `(*gate_batch, *core)` with an axis for each point axis of `x` `(*batch, *points, D)`."""
        lead = buffer.ndim - core
        if lead == 0:
            return buffer
        n_points = x.ndim - 1 - len(self.batch_shape)
        return buffer.reshape(*buffer.shape[:lead], *(1,) * n_points, *buffer.shape[lead:])

    def features(self, x: Array) -> Tensor:
        """h_k(x) [x, 1], `(..., K (D+1))`: every output is linear in these features (Eq. 8-9)."""
        x = self._checked(x)
        return (self.gating(x).unsqueeze(-1) * F.pad(x, (0, 1), value=1.0).unsqueeze(-2)).flatten(-2)

    def feature_gating(self, features: Tensor) -> Tensor:
        """h_k for each of the features `(..., K (D+1))`, k the component that the feature belongs to."""
        D = self.input_dim
        return features[..., D :: D + 1].repeat_interleave(D + 1, -1)

    def outputs(self, features: Tensor, rows: Tensor) -> Tensor:
        """[ẋ; s] `(*batch, *points, O+Q)` from `features` `(*batch, *points, F)` and `rows` `(*batch, O+Q, F)`."""
        n_points = features.ndim - rows.ndim + 1
        if n_points <= 0:
            return (rows @ features.unsqueeze(-1)).squeeze(-1)
        for _ in range(n_points - 1):
            rows = rows.unsqueeze(-3)
        return features @ rows.mT

    def field(self, rows: Tensor) -> Field | None:
        """`rows` and gating for compiled code; None for a subclass with outputs of its own making."""
        if any(getattr(type(self), n) is not getattr(GMRPolicy, n) or n in self.__dict__ for n in _OUTPUTS):
            return None
        return Field(rows, self.output_dim, self._center, self.factors, self._offset, self._log_scale)

    def forward(self, x: Array) -> Tensor:
        """The velocity ẋ `(*batch, *points, O)` at `x` `(*batch, *points, D)` (Eq. 1)."""
        return self.outputs(self.features(x), arrange(self.A, self.b))

    def stiffness(self, x: Array) -> Tensor:
        """The stiffness s `(*batch, *points, Q)` at `x` `(*batch, *points, D)`, before any clamping (Eq. 34)."""
        return self.outputs(self.features(x), self.rows())[..., self.output_dim :]

    def basis(self, x: Array) -> Tensor:
        """G of Eq. 8-9 and 42-43, `(..., O+Q, P)`: `basis(x) @ pack()` is [ẋ; s]."""
        x, n = self._checked(x), self.output_dim + self.stiffness_dim
        identity = torch.eye(n, dtype=x.dtype, device=x.device)
        slopes = (identity.unsqueeze(-1) * x[..., None, None, :]).flatten(-2)  # (..., O+Q, (O+Q) D)
        block = torch.cat([slopes, identity.expand(*slopes.shape[:-1], n)], -1)
        return (self.gating(x)[..., None, :, None] * block.unsqueeze(-2)).flatten(-2)

    def jacobian(self, x: Array) -> Tensor:
        r"""∂[ẋ; s]/∂x `(*batch, *points, O+Q, D)`, in closed form.

        .. math:: \sum_k h_k (A_k + y_k (σ_k - \sum_j h_j σ_j)^T), \quad y_k = A_k x + b_k, \quad σ_k = -Σ_k^{-1} (x - μ_k).
        """
        x, K, D = self._checked(x), self.n_components, self.input_dim
        h = self.gating(x)  # (*batch, *points, K)
        z = torch.unflatten(self._whitened(x), -1, (K, D))
        score = -(z.unsqueeze(-2) @ self._at_points(self.factors, 3, x)).squeeze(-2)  # σ_k, (*batch, *points, K, D)
        turn = h.unsqueeze(-1) * (score - (h.unsqueeze(-1) * score).sum(-2, keepdim=True))  # ∂h_k/∂x
        experts = torch.unflatten(self.rows(), -1, (K, D + 1))  # (*batch, O+Q, K, D+1)
        for _ in range(x.ndim - experts.ndim + 2):
            experts = experts.unsqueeze(-4)
        y = (experts @ F.pad(x, (0, 1), value=1.0)[..., None, :, None]).squeeze(-1)  # (*batch, *points, O+Q, K)
        return y @ turn + (h[..., None, :, None] * experts[..., :D]).sum(-2)

    def certificate(self, goal: Array, P: Array | None = None) -> stability.Certificate:
        """What proves that every motion of this policy ends at `goal`; see `torchds.stability.certificate`."""
        return stability.certificate(self, goal, P)
