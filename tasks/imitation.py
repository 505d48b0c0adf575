"""Policies of a joint mixture over [x, v(, s)]: with the stiffness that it carries, or without it and saying so."""

from __future__ import annotations

import warnings

from torchds import GaussianMixture, GMRPolicy
from torchds.errors import DemonstrationWarning, InvalidArgumentError


def without_stiffness(mixture: GaussianMixture, D: int, O: int, why: str) -> GMRPolicy:
    """Position in, velocity out; that variables beyond these are left out is said as a `DemonstrationWarning`.

    Args:
        mixture: over D + O variables, or more.
        D: inputs.
        O: velocities.
        why: why this task has no use for more.
    """
    say_left_out(mixture, D + O, why)
    return GMRPolicy.from_mixture(mixture.marginal(0, D + O), input_dim=D)


def with_stiffness(mixture: GaussianMixture, D: int, O: int, Q: int, initial: float) -> GMRPolicy:
    """Position in, velocity and stiffness out (Eq. 34): the stiffness that the mixture carries, else a constant.

    Args:
        mixture: over D + O variables, or D + O + Q.
        D: inputs.
        O: velocities.
        Q: stiffness outputs of the task.
        initial: the constant s⁰ [N/m].

    Raises:
        InvalidArgumentError: the mixture carries another number of stiffness variables.
    """
    carried = mixture.means.shape[-1] - D - O
    if carried == Q:
        return GMRPolicy.from_mixture(mixture, D, stiffness_dim=Q)
    if carried > 0:
        raise InvalidArgumentError(
            f"the stiffness carried by the mixture has to have {Q} column(s) for this task, got {carried}; give "
            f"demonstrations with {Q}, or take the motion alone: mixture.marginal(0, {D + O})"
        )
    return GMRPolicy.from_mixture(mixture, D, stiffness_dim=Q, stiffness=initial)


def with_constant_stiffness(policy: GMRPolicy, Q: int, initial: float) -> GMRPolicy:
    """The motion of a policy that carries none, with a constant stiffness s⁰ [N/m] in Q outputs to begin with."""
    K, D = policy.means.shape[-2:]
    slopes, offsets = policy.A.new_zeros(K, Q, D), policy.b.new_full((K, Q), initial)
    return GMRPolicy(policy.priors, policy.means, policy.covariances, policy.A, policy.b, slopes, offsets)


def say_left_out(mixture: GaussianMixture, n: int, why: str) -> None:
    """Warn where a mixture has more than `n` variables."""
    if more := mixture.means.shape[-1] - n:
        warnings.warn(
            f"the mixture carries {more} variable(s) beyond position and velocity, a stiffness say, that are left out: {why}",
            DemonstrationWarning,
            stacklevel=4,
        )
