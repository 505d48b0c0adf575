"""What an optimizer asks of an exploration.

Stability: stable.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor, nn

from torchds.errors import InvalidArgumentError


class Exploration(ABC):
    """Shapes unit normals into parameter noise.

    An optimizer draws one standard normal per parameter entry and roll-out, scales it by its `lr`, and calls the
    exploration on the parameters of one group. Drawing and shaping are apart, so that a test or a comparison can hand
    in its own normals.

    Parameters with requires_grad=False are frozen. An exploration need not know: the optimizer takes the noise that it gives
    them away. One whose noise of some parameters depends on others (as `TrajectorySpace` and `Stable`) looks at it.
    """

    needs_convex_update = False
    """Whether its promise holds for an update only if that is a convex combination of the roll-outs, slope by slope."""

    @abstractmethod
    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """The noise of each parameter.

        Args:
            parameters: of one optimizer group, at their unperturbed values.
            normals: one `(N, *parameter.shape)` for each, standard normal times the scale of the exploration.

        Returns:
            One `(N, *parameter.shape)` for each.
        """

    def measure(self, parameters: Sequence[nn.Parameter], changes: Sequence[Tensor]) -> list[Tensor]:
        """Changes of parameters in coordinates whose Euclidean distance says how different two roll-outs are.

        Only ratios of distances matter. Here the changes as they are; an exploration that knows better says so.

        Args:
            parameters: of one optimizer group, at their unperturbed values.
            changes: `(n, *parameter.shape)` for each.

        Returns:
            One `(n, *parameter.shape)` for each, linear in the changes.
        """
        return list(changes)

    def check(self, parameters: Sequence[nn.Parameter]) -> None:
        """Refuse parameters that this exploration cannot perturb, before any learning starts.

        Raises:
            InvalidArgumentError: what was received and what is allowed.
        """

    def scalars(self) -> dict[str, float]:
        """What is worth logging after each update, by TensorBoard tag."""
        return {}

    def state_dict(self) -> dict[str, Any]:
        """What changes while learning; plain values and tensors only."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take over what `state_dict` gave.

        Raises:
            InvalidArgumentError: it is not of this kind.
        """
        if state:
            raise InvalidArgumentError(f"{type(self).__name__} keeps no state, got one with {sorted(map(str, state))}")


def name_parameters(module: nn.Module, parameters: Sequence[nn.Parameter], who: str) -> list[str]:
    """The name in `module` of each parameter.

    Raises:
        InvalidArgumentError: a parameter is not one of the module's.
    """
    names = {id(p): name for name, p in module.named_parameters()}
    strangers = [tuple(p.shape) for p in parameters if id(p) not in names]
    if strangers:
        raise InvalidArgumentError(
            f"{who} explores {sorted(names.values())} of the policy it was made with, but the optimizer group has other "
            f"parameters of shape {strangers}; make the exploration with the policy whose parameters are optimised"
        )
    return [names[id(p)] for p in parameters]
