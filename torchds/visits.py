"""What roll-outs tell an optimizer that listens: which features of which policy they visited.

The control cost of Algorithm 1 needs the features along every roll-out, a closure returns only costs. So roll-outs
report their features here, and an optimizer listens while its closure runs. A foreign simulator reports with one call:
`torchds.visits.report(policy, policy.features(x))`.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from torchds.errors import InvalidArgumentError


class LinearPolicy(Protocol):
    """A policy whose outputs are linear in features: rows `(*batch, O, F)` times features `(..., F)`."""

    @property
    def initial_rows(self) -> Tensor:
        """The rows that deviations are measured from."""

    @property
    def row_parameters(self) -> dict[str, nn.Parameter]:
        """The parameters that the rows consist of, by name."""

    def rows(self, value: Callable[[nn.Parameter], Tensor] | None = None) -> Tensor:
        """Arrange a quantity given per parameter as rows."""

    def from_rows(self, rows: Tensor) -> dict[str, Tensor]:
        """Take rows apart into parameters, by name."""

    def feature_gating(self, features: Tensor) -> Tensor:
        """The activation of the component that each feature belongs to."""


class Gated(NamedTuple):
    """Features h_k [x, 1] of K linear experts of D inputs, in the two parts that they consist of: a third of the numbers.

    Attributes:
        gating: `(*batch, *points, T, K)` h.
        inputs: `(*batch, *points, T, D)` x.
    """

    gating: Tensor
    inputs: Tensor

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the features, `(*batch, *points, T, K (D+1))`."""
        *lead, K = self.gating.shape
        return *lead, K * (self.inputs.shape[-1] + 1)

    @property
    def features(self) -> Tensor:
        """`(*batch, *points, T, K (D+1))`."""
        return (self.gating.unsqueeze(-1) * F.pad(self.inputs, (0, 1), value=1.0).unsqueeze(-2)).flatten(-2)


def whole(visited: Tensor | Gated) -> Tensor:
    """The features `(*batch, *points, T, F)`, whichever way they were kept."""
    return visited.features if isinstance(visited, Gated) else visited


class Visit(NamedTuple):
    """One roll-out's report: the policy, and the features `(*batch, *points, T, F)` that it saw, as such or `Gated`."""

    policy: LinearPolicy
    visited: Tensor | Gated

    @property
    def features(self) -> Tensor:
        """`(*batch, *points, T, F)`."""
        return whole(self.visited)


listener: ContextVar[list[Visit] | None] = ContextVar("torchds_visits", default=None)
"""What collects the visits that are reported now; None where nobody listens."""


@contextmanager
def listen() -> Iterator[list[Visit]]:
    """Collect the visits that are reported inside the block; an inner block hides them from an outer one."""
    visits: list[Visit] = []
    token = listener.set(visits)
    try:
        yield visits
    finally:
        listener.reset(token)


def report(policy: LinearPolicy, features: Tensor | Gated) -> None:
    """Tell whoever listens that `policy` visited `features` `(*batch, *points, T, F)`.

    Raises:
        InvalidArgumentError: no policy that is linear in features, or features that are no tensor.
    """
    if torch.compiler.is_compiling():  # nobody can listen to a compiled program
        return
    visits = listener.get()
    if visits is not None:
        visits.append(checked((policy, features)))


def checked(visit: Any) -> Visit:
    """A visit from anything that a user may hand in as one.

    Raises:
        InvalidArgumentError: see `report`.
    """
    try:
        policy, features = visit
    except (TypeError, ValueError):
        policy, features = None, visit
    if not hasattr(policy, "rows") or not isinstance(features, (Tensor, Gated)):
        raise InvalidArgumentError(
            "a visit is (policy, features) of a policy that is linear in features and a tensor (*batch, *points, T, F), got "
            f"{type(policy).__name__} and {type(features).__name__}; use Visit(policy, policy.features(x))"
        )
    return Visit(policy, features)
