"""Policies as files of other programs: ONNX, packages of compiled code, headers for C, and programs of torch alone.

Stability: stable.
"""

from __future__ import annotations

import copy
import importlib.util
import io
import tempfile
import warnings
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor, nn

from torchds import c_header
from torchds.errors import InvalidArgumentError, MissingPackageError, UnknownNameError
from torchds.files import write_atomically
from torchds.policy import GMRPolicy
from torchds.rollouts import rollout

if TYPE_CHECKING:
    from torch.export import ExportedProgram

Format = Literal["onnx", "aoti", "torch", "c"]


class _Field(nn.Module):
    """x `(n, D)` to the velocity `(n, O)`, and the stiffness `(n, Q)` where there is one."""

    def __init__(self, policy: GMRPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        y = self.policy.outputs(self.policy.features(x), self.policy.rows())
        v, s = y[..., : self.policy.output_dim], y[..., self.policy.output_dim :]
        return (v, s) if self.policy.stiffness_dim else (v,)


class _Motion(_Field):
    """x `(n, D)` to the motion from there: positions `(n, T+1, D)`, velocities `(n, T, O)`, and the stiffness `(n, T, Q)`."""

    def __init__(self, policy: GMRPolicy, n_steps: int, dt: float) -> None:
        super().__init__(policy)
        self.n_steps, self.dt = n_steps, dt

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        path = rollout(self.policy, x, self.n_steps, self.dt)
        return (path.x, path.v) if path.stiffness is None else (path.x, path.v, path.stiffness)


def export(
    policy: GMRPolicy,
    path: str | PathLike[str],
    n_steps: int | None = None,
    dt: float | None = None,
    format: Format = "onnx",
) -> None:
    """Write the field of a policy, or with `n_steps` and `dt` the whole motion from a start, for programs without torchds.

    The program takes positions x `(n, D)`, of any n, in the dtype of the policy. That of the field gives the velocities
    `(n, O)`; that of the motion the positions `(n, T+1, D)` and the velocities `(n, T, O)`. A stiffness comes last.

    Args:
        policy: a single one, without batch dimensions.
        path: of the file.
        n_steps: T.
        dt: time step [s].
        format: "onnx" for ONNX Runtime and others (extra "export"). "aoti" for machine code of this machine that
            `torch._inductor.aoti_load_package` opens, from Python or C++; it needs a C++ compiler, and a motion takes one start
            only, n = 1. "torch" for a program that `torch.export.load` opens. "c" for a header of C99 and C++, the field of
            one x in doubles, with functions `NAME_evaluate(x, y)` and `NAME_step(x, dt, y)` for a file NAME.h.

    Raises:
        UnknownNameError: the format.
        InvalidArgumentError: a batch of policies, one of `n_steps` and `dt` without the other, or a motion as "c".
        MissingPackageError: "onnx" without the extra "export".

    Example:
        >>> import tempfile, torch, torchds
        >>> mixture = torchds.GaussianMixture(torch.ones(1), torch.zeros(1, 4), torch.eye(4)[None])
        >>> policy = torchds.GMRPolicy.from_mixture(mixture, input_dim=2)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     torchds.export(policy, f"{folder}/field.pt2", format="torch")
        ...     field = torch.export.load(f"{folder}/field.pt2").module()
        >>> field(torch.ones(3, 2))[0].shape
        torch.Size([3, 2])
    """
    if format not in get_args(Format):
        raise UnknownNameError("format", format, get_args(Format))
    if policy.batch_shape:
        raise InvalidArgumentError(
            f"export takes one policy, got a batch {policy.batch_shape}; export them one by one, policy[i]"
        )
    if (n_steps is None) != (dt is None):
        raise InvalidArgumentError(
            f"n_steps and dt have to be given together, for a motion, or not at all, for the field; got {n_steps} and {dt}"
        )
    if format == "c":
        if n_steps is not None:
            raise InvalidArgumentError(
                'format="c" writes the field, and NAME_step, which integrates it; leave n_steps and dt out'
            )
        header = c_header.header(policy, Path(path).stem)
        return write_atomically(Path(path), lambda stream: stream.write(header))
    writers: dict[str, Callable[[ExportedProgram], bytes]] = {"onnx": _onnx, "aoti": _aoti, "torch": _torch}
    single = copy.deepcopy(policy).requires_grad_(False)
    program = _Field(single) if n_steps is None or dt is None else _Motion(single, n_steps, dt)
    n = 1 if format == "aoti" and n_steps is not None else 2
    shapes = {"x": {0: torch.export.Dim("n")}} if n > 1 else None
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of torch and onnx about themselves
        example = policy.means[:1].detach().expand(n, -1).clone()
        content = writers[format](torch.export.export(program, (example,), dynamic_shapes=shapes))
    write_atomically(Path(path), lambda stream: stream.write(content))


def _torch(program: ExportedProgram) -> bytes:
    buffer = io.BytesIO()
    torch.export.save(program, buffer)
    return buffer.getvalue()


def _aoti(program: ExportedProgram) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "package.pt2")
        torch._inductor.aoti_compile_and_package(program, package_path=str(place))
        return place.read_bytes()


def _onnx(program: ExportedProgram) -> bytes:
    for package in ("onnx", "onnxscript"):
        if importlib.util.find_spec(package) is None:
            raise MissingPackageError(package, "export", "an ONNX file")
    model: Any = torch.onnx.export(program, dynamo=True, verbose=False)
    proto = model.model_proto
    _restore(proto, program)
    serialised: bytes = proto.SerializeToString()
    return serialised


def _restore(model: Any, program: ExportedProgram) -> None:
    """Give the numbers of the program their last digits back: torch writes those that are no tensors with 32 bits."""
    from onnx import numpy_helper

    exact = {}
    for part in program.graph_module.modules():
        for node in part.graph.nodes if isinstance(part, torch.fx.GraphModule) else ():
            for number in (*node.args, *node.kwargs.values()):
                if isinstance(number, float):
                    with np.errstate(over="ignore"):
                        exact[float(np.float32(number))] = number
    for tensor in model.graph.initializer:
        value = numpy_helper.to_array(tensor)
        if value.dtype == np.float64 and value.size == 1 and value.item() in exact:
            whole = np.full(value.shape, exact[value.item()])
            tensor.CopyFrom(numpy_helper.from_array(whole, tensor.name))
