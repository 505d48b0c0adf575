"""The error family: every message says what was received, what is allowed, and how to fix it.

Stability: stable.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class TorchdsError(Exception):
    """Root of all errors raised by this project."""


class InvalidArgumentError(TorchdsError, ValueError):
    """An argument has a value, a shape or a combination that is not allowed."""


class InvalidDemonstrationsError(TorchdsError, ValueError):
    """Recorded data cannot be used: too short, not finite, mixed dimensions, no time step."""


class FileError(TorchdsError, ValueError):
    """A file is missing, cannot be read, or does not hold what was expected of it."""


class DemonstrationWarning(UserWarning):
    """Recorded data can be used, but look as if they were something else than they seem (`Demonstrations.check`)."""


class LargestMixtureWarning(UserWarning):
    """The best number of Gaussians is the largest that was allowed, so that a larger one may be better."""


class EqualCostsWarning(UserWarning):
    """All roll-outs of a run cost the same, so that an optimizer learned nothing from them and left the parameters alone."""


class LastDigitsWarning(UserWarning):
    """A session was begun on another processor or with other versions: it goes on, and its last digits may be others."""


class DegenerateMixtureError(TorchdsError, ValueError):
    """A Gaussian mixture cannot be fitted to, or built from, what was given."""


class UnknownNameError(TorchdsError, ValueError):
    """A name is not in a registry; the message lists the nearest names and all that exist."""

    def __init__(self, kind: str, received: str, allowed: Iterable[str]) -> None:
        allowed = sorted(allowed)
        lowered = {name.lower(): name for name in allowed}
        near = [lowered[n] for n in difflib.get_close_matches(received.lower(), lowered, n=3, cutoff=0.5)]
        hint = f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
        super().__init__(f"unknown {kind} {received!r}.{hint} Known: {', '.join(allowed)}.")


class AllRolloutsFailedError(TorchdsError, RuntimeError):
    """Every roll-out of an update had a cost that is not finite; the parameters were left as they were."""


class ProcessLostError(TorchdsError, RuntimeError):
    """Another process of a group ended, or was silent for longer than the group waits; nothing was changed."""


class MissingPackageError(TorchdsError, ImportError):
    """An optional package is not installed; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs the package {package!r}. Install it with: pip install 'torchds[{extra}]'")
