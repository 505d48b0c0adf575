"""The parameters of linear experts, and three ways to write them: by name, as rows of the outputs, as the vector θ.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Self

import torch
from torch import Tensor, nn

from torchds import policy_file
from torchds.arrays import Array, broadcast_shape, real
from torchds.errors import InvalidArgumentError


class ExpertParameters(nn.Module):
    r"""K linear experts of D inputs, y_k = A_k x + b_k, with O velocity rows and Q stiffness rows (Eq. 34).

    Learnable are `A`, `b` and, for Q > 0, `stiffness_A`, `stiffness_b`; all four may carry leading batch dimensions, the
    `batch_shape`. The values given are kept in the buffers `initial_A`, ..., from which changes are measured.

    Args:
        A: `(*batch, K, O, D)` slopes of the velocity.
        b: `(*batch, K, O)` offsets of the velocity.
        stiffness_A: `(*batch, K, Q, D)` slopes of the stiffness.
        stiffness_b: `(*batch, K, Q)` offsets of the stiffness.

    Attributes:
        n_components: K.
        input_dim: D.
        output_dim: O, the number of velocities.
        stiffness_dim: Q, the number of stiffness outputs.
    """

    info: policy_file.Info = policy_file.Info()
    """What belongs to the policy beside its field; `save` writes it, and a policy from a file has it."""

    A: nn.Parameter
    b: nn.Parameter
    stiffness_A: nn.Parameter
    stiffness_b: nn.Parameter
    initial_A: Tensor
    initial_b: Tensor
    initial_stiffness_A: Tensor
    initial_stiffness_b: Tensor

    def __init__(self, A: Tensor, b: Tensor, stiffness_A: Tensor, stiffness_b: Tensor) -> None:
        super().__init__()
        self.n_components, self.output_dim, self.input_dim = A.shape[-3:]
        self.stiffness_dim = stiffness_A.shape[-2]
        named = {"A": A, "b": b, "stiffness_A": stiffness_A, "stiffness_b": stiffness_b}
        for name, value in named.items():
            self.register_buffer(f"initial_{name}", value.detach().clone())
            if not name.startswith("stiffness") or stiffness_A.shape[-2]:
                self.register_parameter(name, nn.Parameter(value.detach().clone()))
            else:
                self.register_parameter(name, None)

    # ------------------------------------------------------------------ shapes

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions of the parameters, () for one policy."""
        lead = [self.A.shape[:-3], self.b.shape[:-2]]
        if self.stiffness_dim:
            lead += [self.stiffness_A.shape[:-3], self.stiffness_b.shape[:-2]]
        return broadcast_shape(*lead)

    # ------------------------------------------------------------------ rows of the outputs

    @property
    def row_parameters(self) -> dict[str, nn.Parameter]:
        """The parameters that the rows consist of, by name."""
        if not self.stiffness_dim:
            return {"A": self.A, "b": self.b}
        return {"A": self.A, "b": self.b, "stiffness_A": self.stiffness_A, "stiffness_b": self.stiffness_b}

    def rows(self, value: Callable[[nn.Parameter], Tensor] | None = None) -> Tensor:
        """The parameters as `(*batch, O+Q, K (D+1))`, row o = [A_1 row o, b_1[o], A_2 row o, ...].

        Args:
            value: what to arrange in place of each parameter (its noise, its deviation), of the parameter's shape with
                any batch in front.
        """
        return arrange(*(p if value is None else value(p) for p in self.row_parameters.values()))

    @property
    def initial_rows(self) -> Tensor:
        """`rows` of the demonstrated policy (Eq. 12-13)."""
        stiffness = (self.initial_stiffness_A, self.initial_stiffness_b) if self.stiffness_dim else ()
        return arrange(self.initial_A, self.initial_b, *stiffness)

    def from_rows(self, rows: Tensor) -> dict[str, Tensor]:
        """The inverse of `rows`: the parameters, by name, that `rows` `(*batch, O+Q, K (D+1))` stands for."""
        D, O = self.input_dim, self.output_dim
        experts = torch.unflatten(rows, -1, (self.n_components, D + 1)).movedim(-2, -3)  # (*batch, K, O+Q, D+1)
        named = {"A": experts[..., :O, :D], "b": experts[..., :O, D]}
        if self.stiffness_dim:
            named |= {"stiffness_A": experts[..., O:, :D], "stiffness_b": experts[..., O:, D]}
        return named

    # ------------------------------------------------------------------ the flat vector θ

    def pack(self, value: Callable[[nn.Parameter], Tensor] | None = None) -> Tensor:
        """θ `(*batch, P)` in the paper's order: per component all of A row by row, then b (Eq. 10-11, 44-45).

        Args:
            value: what to pack in place of each parameter, as for `rows`.
        """
        return self.join({name: p if value is None else value(p) for name, p in self.row_parameters.items()})

    def join(self, named: Mapping[str, Tensor]) -> Tensor:
        """The inverse of `split`: θ `(*batch, P)` from the parameters by name."""
        A, b = named["A"], named["b"]
        if self.stiffness_dim:
            A, b = cat_broadcast([A, named["stiffness_A"]], -2), cat_broadcast([b, named["stiffness_b"]], -1)
        return cat_broadcast([A.flatten(-2), b], -1).flatten(-2)

    def split(self, theta: Array) -> dict[str, Tensor]:
        """The parameters, by name, that `theta` `(*batch, P)` stands for; differentiable, changes nothing.

        Raises:
            InvalidArgumentError: `theta` does not have P entries.
        """
        K, D, O, Q = self.n_components, self.input_dim, self.output_dim, self.stiffness_dim
        P = K * (O + Q) * (D + 1)
        theta = theta if isinstance(theta, Tensor) and not theta.is_complex() else real("theta", theta)
        if theta.shape[-1:] != (P,):
            raise InvalidArgumentError(f"theta has to be (*batch, {P}) for this policy, got {tuple(theta.shape)}")
        blocks = torch.unflatten(theta, -1, (K, (O + Q) * (D + 1)))
        A, b = torch.unflatten(blocks[..., : (O + Q) * D], -1, (O + Q, D)), blocks[..., (O + Q) * D :]
        named = {"A": A[..., :O, :], "b": b[..., :O]}
        return named | ({"stiffness_A": A[..., O:, :], "stiffness_b": b[..., O:]} if Q else {})

    def unpack(self, theta: Array) -> Self:
        """Write `theta` `(*batch, P)` into the parameters, taking over its batch, and return this policy.

        The parameters stay the same objects, so an optimizer that holds them sees the new values.

        Raises:
            InvalidArgumentError: `theta` does not have P entries.
        """
        for name, value in self.split(real("theta", theta).detach()).items():
            parameter = self.get_parameter(name)
            if parameter.shape != value.shape:
                parameter.grad = None  # of another batch; autograd could not add to it
            parameter.data = value.to(parameter).clone()
        return self

    # ------------------------------------------------------------------ a file

    def save(
        self,
        path: str | Path,
        *,
        goal: Array | None = None,
        P: Array | None = None,
        names: Sequence[str] = (),
        units: str = "",
        dt: float | None = None,
    ) -> None:
        """Write the policy, of any batch, to one file that `torchds.load_policy` and `torchds.Controller.load` read.

        Torch opens it too, `torch.load(path, weights_only=True)["content"]`. What is not given is taken from `info`.

        Args:
            path: of the file, such as "policy.pt".
            goal: `(D,)` or `(*batch, D)` where the motions end.
            P: `(D, D)` or `(*batch, D, D)` of the condition of stability that holds.
            names: of the D inputs.
            units: of positions, such as "m".
            dt: time step that it is meant for [s].

        Raises:
            InvalidArgumentError: what is given does not fit D inputs.
            FileError: the file cannot be written; what was there before is unchanged.
        """
        info = policy_file.completed(self.info, self.input_dim, goal, P, names, units, dt)
        policy_file.write(path, dict(self.named_buffers(recurse=False)) | dict(self.row_parameters), info)


def arrange(A: Tensor, b: Tensor, *stiffness: Tensor) -> Tensor:
    """The rows `(*batch, O+Q, K (D+1))` of slopes and offsets; of the velocity alone where no stiffness is given."""
    experts = cat_broadcast([A, b.unsqueeze(-1)], -1)  # (*batch, K, O, D+1)
    if stiffness:
        experts = cat_broadcast([experts, cat_broadcast([stiffness[0], stiffness[1].unsqueeze(-1)], -1)], -2)
    return experts.transpose(-3, -2).flatten(-2)


def cat_broadcast(tensors: list[Tensor], dim: int) -> Tensor:
    """Concatenate along `dim` after broadcasting the leading dimensions.

    An optimizer of some of a policy's parameters gives leading dimensions to these only.
    """
    if len({t.ndim for t in tensors}) > 1:
        last = [t.movedim(dim, -1) for t in tensors]
        lead = broadcast_shape(*(t.shape[:-1] for t in last))
        tensors = [t.expand(*lead, t.shape[-1]).movedim(-1, dim) for t in last]
    return torch.cat(tensors, dim)
