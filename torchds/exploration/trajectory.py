"""Noise that is homogeneous along the whole motion (beyond section 4.1).

Letters: `P` parameters of a policy, flattened; `T` steps of the motion; `D` inputs, `O` velocity outputs.

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn

from torchds.arrays import Array, beside, count, number, real, shown, transformed
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration, name_parameters
from torchds.exploration.homogeneous import Homogeneous, chi_mean
from torchds.exploration.shares import motion_size
from torchds.policy import GMRPolicy
from torchds.rollouts import rollout
from torchds.sensitivity import sensitivity, stiffness_sensitivity


class Coordinates(NamedTuple):
    """θ = center + factor z, for any other searcher: equal steps of z move the motion by comparable amounts.

    Attributes:
        center: `(*batch, P)` θ₀, in the order of `GMRPolicy.pack`.
        factor: `(*batch, P, P)` L, with the covariance L Lᵀ.
    """

    center: Tensor
    factor: Tensor

    def theta(self, z: Array) -> Tensor:
        """The parameters `(*batch, P)` at `z` `(*batch, P)`."""
        steps = beside("z", z, self.center, "(*batch, P)")
        return self.center + (self.factor @ steps.unsqueeze(-1)).squeeze(-1)


class TrajectorySpace(Exploration):
    r"""Correlated noise that moves every part of the motion by about the same distance.

    `Homogeneous` makes the velocity noise equal at the centres; what becomes of it after a hundred steps differs by
    orders of magnitude between directions of θ. Here the roll-out's Jacobian J = ∂(x_1 … x_T)/∂θ decides: with D the
    homogeneous variances times `widening`\ ², the covariance is

    .. math:: C = (J^T J / (T\, spread^2) + D^{-1})^{-1},

    wide where the motion does not feel a direction, narrow where it does. In the eigenvectors V of
    D_1^{1/2} (JᵀJ/(T spread²)) D_1^{1/2} (D_1 for `widening` 1, eigenvalues λ) that is one variance per direction, to which
    `damping` adds a factor: directions that the motion does not feel at all would drift at random and are left alone,

    .. math:: σ_i^2 = \frac{1}{λ_i + 1 / widening^2} \cdot \frac{λ_i}{λ_i + damping\, λ_{max}}.

    Frozen parameters (requires_grad=False) have no noise, and the rest has that which C has without them.

    J is exact and follows the policy as it changes. Where it is not finite (a diverging motion), the noise falls back to
    the homogeneous one. docs/exploration.md derives this and says when it does not help.

    Args:
        policy: whose parameters are explored, all of them.
        x0: `(*points, D)` the starts of the motion.
        n_steps: T.
        dt: time step [s].
        spread: how far the motion may be moved, root mean square over time [position unit]; one number, or `(O,)` where
            velocities beyond the inputs have another unit, as an angle's rate has (Eq. 36).
        stiffness_spread: how far the stiffness along the motion may be moved, root mean square [N/m]; for a policy with
            stiffness rows, whose outputs then count in JᵀJ beside the positions, each divided by its spread.
        mean_speed: of the homogeneous noise behind D [velocity unit].
        mean_stiffness: of that noise in each stiffness row [N/m].
        widening: how much wider than the homogeneous noise a direction may be.
        damping: relative size, of the largest λ, below which a direction is left alone; 0 for the plain covariance.
        refresh: updates between two evaluations of J.
        goal: `(D,)` x*, to which b stays tied: only A is free and b = −A x* follows, as `Stable` wants it. Behind D there is
            then one standard deviation for all of A, so that the velocity noise grows with the distance from the goal as
            the velocity does; averaged over the Gaussians its mean norm is `mean_speed`.

    Raises:
        InvalidArgumentError: numbers out of range, a goal of another shape, or a group with only a part of the policy's
            parameters.
    """

    def __init__(
        self,
        policy: GMRPolicy,
        x0: Array,
        n_steps: int,
        dt: float,
        spread: float | Array,
        *,
        stiffness_spread: float | None = None,
        mean_speed: float = 0.1,
        mean_stiffness: float = 0.0,
        widening: float = 3.0,
        damping: float = 1e-2,
        refresh: int = 1,
        goal: Array | None = None,
    ) -> None:
        for name, value in {"widening": widening, "mean_speed": mean_speed}.items():
            number(name, value, "finite and positive", lambda n: 0 < n < math.inf)
        each = real("spread", spread).double()
        if each.shape not in ((), (policy.output_dim,)) or not (each.isfinite() & (each > 0)).all():
            raise InvalidArgumentError(
                f"spread has to be finite and positive, one number or ({policy.output_dim},), got {spread}"
            )
        if not damping >= 0 or refresh < 1:
            raise InvalidArgumentError(f"damping has to be ≥ 0 and refresh at least 1, got {damping} and {refresh}")
        x_star = None if goal is None else real("goal", goal)
        if x_star is not None and x_star.shape != (policy.input_dim,):
            raise InvalidArgumentError(f"goal has to be ({policy.input_dim},), got {tuple(x_star.shape)}")
        self.policy, self.goal = policy, x_star
        self.x0 = real("x0", x0, "(*points, D)")
        if self.x0.shape[-1] != policy.input_dim:
            raise InvalidArgumentError(f"x0 has to be (*points, {policy.input_dim}), got {tuple(self.x0.shape)}")
        self.n_steps, self.dt = count("n_steps", n_steps, 1), dt
        self.spread, self.widening, self.damping = each, widening, damping
        self.refresh = refresh
        if policy.stiffness_dim and not ((stiffness_spread or 0) > 0 and mean_stiffness > 0):
            raise InvalidArgumentError(
                "stiffness_spread and mean_stiffness have to be positive for a policy with stiffness rows, got "
                f"{stiffness_spread} and {mean_stiffness}; TrajectorySpace.relative chooses both"
            )
        self.stiffness_spread = stiffness_spread or 1.0
        self._homogeneous = Homogeneous(policy, mean_speed, mean_stiffness=mean_stiffness)
        self._age = 0
        self._factor: Tensor | None = None
        self._felt: Tensor | None = None
        self._metric: Tensor | None = None  # the root of what is felt, once it was asked for

    @classmethod
    def relative(
        cls,
        policy: GMRPolicy,
        x0: Array,
        n_steps: int,
        dt: float,
        spread: float = 0.05,
        *,
        speed: float = 0.12,
        stiffness: float = 0.2,
        goal: Array | None = None,
    ) -> TrajectorySpace:
        """The same in shares of the motion that `policy` makes now, so that one setting does for many tasks.

        Args:
            policy: whose parameters are explored.
            x0: `(*points, D)` the starts of the motion.
            n_steps: T.
            dt: time step [s].
            spread: share of the motion's extent, the root mean square distance from its own mean place. Outputs beyond
                the positions have an extent of their own.
            speed: `mean_speed` as a share of the mean speed.
            stiffness: `mean_stiffness` and `stiffness_spread` as a share of the mean stiffness.
            goal: `(D,)` x*, to which b stays tied; None for free offsets.

        Returns:
            Noise whose sizes are numbers from now on: they do not follow the policy as it changes.

        Raises:
            InvalidArgumentError: what `TrajectorySpace` refuses; also a policy that does not move.
        """
        size = motion_size(policy, x0, n_steps, dt)
        sizes: dict[str, Any] = {"mean_speed": speed * size.speed}
        if policy.stiffness_dim:
            sizes |= {"mean_stiffness": stiffness * size.stiffness, "stiffness_spread": stiffness * size.stiffness}
        return cls(policy, x0, n_steps, dt, spread * size.extent, **sizes, goal=goal)

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse a part of the policy's parameters, and those of others.

        Raises:
            InvalidArgumentError: which are missing, or not the policy's.
        """
        names = name_parameters(self.policy, parameters, type(self).__name__)
        if missing := {name for name, _ in self.policy.named_parameters()} - set(names):
            raise InvalidArgumentError(
                f"TrajectorySpace explores all parameters of a policy together, but {sorted(missing)} are not in the group"
            )

    @property
    def factor(self) -> Tensor:
        """L `(*batch, P, P)`, the covariance's root in the order of `GMRPolicy.pack`; evaluated where it is due."""
        if self._factor is None or self._age >= self.refresh:
            return self.refresh_now()
        return self._factor

    def refresh_now(self) -> Tensor:
        """Evaluate the covariance at the present parameters, due or not, and return its root L `(*batch, P, P)`."""
        self._factor, self._age = self._evaluate(), 0
        return self._factor

    @property
    def covariance(self) -> Tensor:
        """C `(*batch, P, P)` of unit normals."""
        return self.factor @ self.factor.mT

    def coordinates(self) -> Coordinates:
        """The present parameters as the centre of coordinates in which other searchers may work."""
        return Coordinates(self.policy.pack().detach().clone(), self.factor.clone())

    @torch.no_grad()
    def _evaluate(self) -> Tensor:
        policy, n_batch = self.policy, len(self.policy.batch_shape)
        path = rollout(policy, self.x0, self.n_steps, self.dt)
        J = sensitivity(policy, path)  # (*batch, *points, T, O, P)
        n = J[..., 0, 0].flatten(n_batch).shape[-1]  # times and points
        rows = [(J / self.spread.to(J)[..., None]).flatten(n_batch, -2)]
        if policy.stiffness_dim:
            rows.append(stiffness_sensitivity(policy, path, J).flatten(n_batch, -2) / self.stiffness_spread)
        felt = torch.cat(rows, -2)
        self._felt, self._metric = felt.mT @ felt / n, None  # JᵀJ/(T spread²)
        chart = self._chart()
        metric = chart.mT @ self._felt @ chart
        good = metric.isfinite().all(-1).all(-1, keepdim=True)  # (*batch, 1)
        values, vectors = torch.linalg.eigh(torch.where(good.unsqueeze(-1), metric, 0.0))
        values = values.clamp_min(0.0)
        variance = 1.0 / (values + self.widening**-2)
        if self.damping:
            largest = values.amax(-1, keepdim=True).clamp_min(torch.finfo(values.dtype).tiny)
            variance = variance * values / (values + self.damping * largest)
        variance = torch.where(good, variance, 1.0)  # no finite Jacobian: the homogeneous noise
        # The symmetric root: eigenvectors have no sign or order of their own, and must not decide about the noise.
        root: Tensor = chart @ (vectors * variance.sqrt().unsqueeze(-2)) @ vectors.mT
        return root

    def _chart(self) -> Tensor:
        """D₁^{1/2} `(P, P)` or `(*batch, P, P)` of the parameters that are not frozen."""
        chart = self._whole_chart()
        if all(p.requires_grad for p in self.policy.row_parameters.values()):
            return chart
        free = self.policy.pack(lambda p: torch.full_like(p, float(p.requires_grad)))
        return chart * free.unsqueeze(-1)

    def _whole_chart(self) -> Tensor:
        """With a goal, ε_b = −ε_A x* in place of noise of its own (Eq. 23)."""
        policy, std = self.policy, self._homogeneous.std()
        if self.goal is None:
            return torch.diag_embed(policy.join(std))
        # |x − x*| under each Gaussian, root mean square; one standard deviation for all of A, since noise that is as fast near
        # the goal as elsewhere would be large noise of the slopes there.
        away = (policy.means - self.goal.to(policy.means)).square() + policy.covariances.diagonal(dim1=-2, dim2=-1)
        distance = (policy.priors * away.sum(-1).sqrt()).sum(-1)  # (*gate_batch)
        speed = self._homogeneous.mean_speed / chi_mean(policy.output_dim)
        std["A"] = (speed / distance)[..., None, None, None].expand_as(std["A"])
        follow = policy.split(torch.eye(policy.pack().shape[-1], dtype=away.dtype, device=away.device))
        follow["b"] = -(follow["A"] @ self.goal.to(away).unsqueeze(-1)).squeeze(-1)
        tie = policy.join(follow).mT  # columns that belong to b are zero
        return tie * policy.join(std).unsqueeze(-2)

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """L z, cut into the parameters: for normals `(N, *p.shape)` of each parameter p, noise of the same shapes."""
        noise = self._through(self.factor, parameters, normals)
        self._age += 1
        return noise

    @torch.no_grad()
    def measure(self, parameters: Sequence[nn.Parameter], changes: Sequence[Tensor]) -> list[Tensor]:
        """(JᵀJ/(T spread²))^{1/2} δθ: the length of it is how far the motion moves to first order, in units of `spread`.

        Args:
            parameters: all of the policy's.
            changes: δθ, `(*lead, *p.shape)` for each parameter p.

        Returns:
            Of the shapes of `changes`. Where J is not finite, the changes themselves.
        """
        if self._felt is None:
            self.refresh_now()
        if self._metric is None:
            self._metric = _root(cast(Tensor, self._felt))
        return self._through(self._metric, parameters, changes)

    def _through(self, matrix: Tensor, parameters: Sequence[nn.Parameter], parts: Sequence[Tensor]) -> list[Tensor]:
        """`matrix` `(*batch, P, P)` times what `parts` are, cut into parameters again."""
        given = {id(p): part for p, part in zip(parameters, parts, strict=True)}
        stacked = self.policy.pack(lambda p: given[id(p)])
        cut = self.policy.split(transformed(matrix, stacked))
        return [cut[name] for name in name_parameters(self.policy, parameters, type(self).__name__)]

    def state_dict(self) -> dict[str, Any]:
        """The covariance in use, what it was made of, and its age."""
        return {"age": self._age, "factor": self._factor, "felt": self._felt}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue with a stored covariance.

        Raises:
            InvalidArgumentError: one of another policy.
        """
        if set(state) != set(self.state_dict()):
            raise InvalidArgumentError(
                f"a state of TrajectorySpace has {sorted(self.state_dict())}, got {sorted(state)}"
            )
        age, n = count("age", state["age"], 0), self.policy.pack().shape[-1]
        shape = (*self.policy.batch_shape, n, n)
        for name in ("factor", "felt"):
            value = state[name]
            if value is not None and (not isinstance(value, Tensor) or tuple(value.shape) != shape):
                raise InvalidArgumentError(
                    f"{name} of TrajectorySpace has to be {shape} for this policy, got {shown(value)}"
                )
        if (state["factor"] is None) != (state["felt"] is None) or not all(
            value is None or value.dtype == self.policy.A.dtype for value in (state["factor"], state["felt"])
        ):
            raise InvalidArgumentError(
                f"factor and felt of TrajectorySpace have to be {self.policy.A.dtype}, both or none"
            )
        self._age, self._factor, self._felt, self._metric = age, state["factor"], state["felt"], None


def _root(felt: Tensor) -> Tensor:
    """The symmetric root `(*batch, P, P)`; the identity where a matrix is not finite."""
    good = felt.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
    identity = torch.eye(felt.shape[-1], dtype=felt.dtype, device=felt.device)
    values, vectors = torch.linalg.eigh(torch.where(good, felt, identity))
    root: Tensor = (vectors * values.clamp_min(0.0).sqrt().unsqueeze(-2)) @ vectors.mT
    return root
