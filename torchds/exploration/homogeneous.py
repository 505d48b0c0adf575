"""Noise that is homogeneous and isotropic in task space (section 4.1).

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from torchds.arrays import Array, like, number
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration, name_parameters
from torchds.exploration.shares import motion_size
from torchds.policy import GMRPolicy

Rule = Literal["moment", "centre", "printed"]


class Homogeneous(Exploration):
    r"""Independent noise whose effect on the velocity has the same size at every centre (Eq. 14-18).

    The velocity noise at a centre, ε_b + Σ_d μ_d ε_{A,d}, gets the mean norm `mean_speed`. In O dimensions that norm
    follows a chi distribution (Rayleigh for 2, Maxwell-Boltzmann for 3), so with \tilde σ = mean_speed / E|z| each of
    the D + 1 terms has the share σ² = \tilde σ² / (D + 1), and

    .. math:: σ_{b^k} = σ, \qquad σ_{A^k_{j,d}} = σ / m_{k,d}.

    Args:
        policy: whose gating gives the centres; its parameters are the ones explored.
        mean_speed: desired mean norm of the velocity noise [velocity unit of the demonstrations].
        rule: what m_{k,d} is.

            * "moment": sqrt(μ_{k,d}² + Σ_{k,dd}), the root mean square of x_d under the Gaussian; stays sensible where
              a centre lies near an axis.
            * "centre": |μ_{k,d}|, Eq. 15 literally, but at least a hundredth of the Gaussian's standard deviation.
            * "printed": Eq. 16-17 as printed, which divide A_{j,d} by μ_j in place of μ_d (the indices exchanged: in
              Eq. 14 A_{j,d} multiplies x_d); with the same floor, for as many outputs as inputs.
        direction: `(O,)` relative size of the noise in each output direction (section 4.4), normalised so that the
            total variance stays the same; None for isotropic noise.
        mean_stiffness: desired mean absolute noise of each stiffness row at the centres [N/m]; the same rule for one
            output dimension. Zero leaves the stiffness alone.

    Raises:
        InvalidArgumentError: sizes that are negative or not finite, an unknown rule, "printed" with O ≠ D, or a
            direction that is not O non-negative numbers with a positive one among them.
    """

    def __init__(
        self,
        policy: GMRPolicy,
        mean_speed: float = 0.1,
        rule: Rule = "moment",
        *,
        direction: Array | None = None,
        mean_stiffness: float = 0.0,
    ) -> None:
        sizes = {"mean_speed": mean_speed, "mean_stiffness": mean_stiffness}
        sizes = {
            name: number(name, value, "finite and ≥ 0", lambda n: 0 <= n < math.inf) for name, value in sizes.items()
        }
        if rule not in get_args(Rule):
            raise InvalidArgumentError(f"rule has to be one of {', '.join(map(repr, get_args(Rule)))}, got {rule!r}")
        if rule == "printed" and policy.output_dim != policy.input_dim:
            raise InvalidArgumentError(
                f"rule='printed' pairs outputs with inputs; this policy has {policy.output_dim} and {policy.input_dim}"
            )
        if direction is not None:
            direction = like("direction", direction, policy.means)
            fits = direction.shape == (policy.output_dim,) and bool(direction.isfinite().all())
            if not fits or (direction < 0).any() or not direction.any():
                raise InvalidArgumentError(
                    f"direction has to be {policy.output_dim} numbers ≥ 0, one of them positive; got {direction}"
                )
        self.policy = policy
        self.mean_speed = sizes["mean_speed"]
        self.rule = rule
        self.direction: Tensor | None = direction
        self.mean_stiffness = sizes["mean_stiffness"]

    @classmethod
    def relative(
        cls,
        policy: GMRPolicy,
        x0: Array,
        n_steps: int,
        dt: float,
        speed: float = 0.12,
        *,
        stiffness: float = 0.2,
    ) -> Homogeneous:
        """The same in shares of the motion that `policy` makes now, so that no unit of a task decides about its noise.

        Args:
            policy: whose parameters are explored.
            x0: `(*points, D)` the starts of the motion.
            n_steps: T.
            dt: time step [s].
            speed: `mean_speed` as a share of the mean speed.
            stiffness: `mean_stiffness` as a share of the mean stiffness.

        Raises:
            InvalidArgumentError: see `Homogeneous`; a policy that does not move has no shares.
        """
        size = motion_size(policy, x0, n_steps, dt)
        if not size.speed > 0:
            raise InvalidArgumentError(
                f"the motion has to have a speed to explore a share of it, got {size.speed}; use Homogeneous(mean_speed=...)"
            )
        return cls(policy, speed * size.speed, mean_stiffness=stiffness * size.stiffness)

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse parameters of another module."""
        name_parameters(self.policy, parameters, type(self).__name__)

    def size(self) -> Tensor:
        """M `(*gate_batch, K, D)`, the typical size of each input under each Gaussian, as the rule has it."""
        means, variances = self.policy.means, self.policy.covariances.diagonal(dim1=-2, dim2=-1)
        if self.rule == "moment":
            return (means.square() + variances).sqrt()
        return torch.maximum(means.abs(), 0.01 * variances.sqrt())

    def std(self) -> dict[str, Tensor]:
        """The standard deviation of each parameter's noise by name, `(*gate_batch, *parameter)` without the policy's batch.

        It is computed once while nothing changes that it depends on.
        """
        numbers = (self.mean_speed, self.rule, self.mean_stiffness)
        tensors = [self.policy.means, self.policy.factors, *([] if self.direction is None else [self.direction])]
        if self._known is None or self._known[0] != numbers or not _same(self._known[1], tensors):
            self._known = numbers, [tensor.clone() for tensor in tensors], self._std()
        return {name: value.clone() for name, value in self._known[2].items()}

    _known: tuple[tuple[object, ...], list[Tensor], dict[str, Tensor]] | None = None  # what std depends on, and std

    def _std(self) -> dict[str, Tensor]:
        policy = self.policy
        D, O, Q = policy.input_dim, policy.output_dim, policy.stiffness_dim
        slope = 1.0 / self.size()  # (*gate_batch, K, D)
        lead = slope.shape[:-1]
        share = math.sqrt(D + 1)
        # The indices of Eq. 16-17 are exchanged: row j is divided by μ_j.
        pattern = slope.unsqueeze(-1 if self.rule == "printed" else -2).expand(*lead, O, D)
        axis = slope.new_ones(O)
        if self.direction is not None:
            axis = self.direction.to(slope)
            axis = axis * (O / axis.square().sum()).sqrt()
        speed = axis * (self.mean_speed / chi_mean(O) / share)  # (O,)
        std = {"A": speed[:, None] * pattern, "b": speed.expand(*lead, O)}
        if Q:
            s = self.mean_stiffness / chi_mean(1) / share
            std |= {
                "stiffness_A": s * slope.unsqueeze(-2).expand(*lead, Q, D),
                "stiffness_b": slope.new_full((*lead, Q), s),
            }
        return std

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """The noise of each parameter, independent between entries."""
        std = self.std()
        names = name_parameters(self.policy, parameters, type(self).__name__)
        return [z * std[name] for name, z in zip(names, normals, strict=True)]

    def measure(self, parameters: Sequence[nn.Parameter], changes: Sequence[Tensor]) -> list[Tensor]:
        """The changes in units of the standard deviations; zero where these are zero."""
        std = self.std()
        names = name_parameters(self.policy, parameters, type(self).__name__)
        return [
            torch.where(std[name] > 0, change / std[name], 0.0) for name, change in zip(names, changes, strict=True)
        ]


def _same(these: Sequence[Tensor], those: Sequence[Tensor]) -> bool:
    kinds = [[(t.dtype, t.device) for t in tensors] for tensors in (these, those)]
    return kinds[0] == kinds[1] and all(map(torch.equal, these, those))


def chi_mean(dim: int) -> float:
    """E|z| of a standard normal vector: √(π/2) in 2-D (Rayleigh), 2√(2/π) in 3-D (Maxwell-Boltzmann)."""
    return math.sqrt(2) * math.exp(math.lgamma((dim + 1) / 2) - math.lgamma(dim / 2))
