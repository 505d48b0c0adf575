"""One file for a policy and all that belongs to it.

Torch opens it with `weights_only=True`, `torchds.load_policy` makes the policy again, and `torchds.Controller.load` reads it
without torch. What is written are values: a policy under `torchds.stability.constrain` comes back as a plain one.

Stability: stable.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchds import files
from torchds.arrays import Array, check_positive, shown, tensor
from torchds.errors import FileError, InvalidArgumentError

KIND = "policy"


class Info(NamedTuple):
    """What belongs to a policy and is no part of its field.

    Attributes:
        goal: `(D,)` or `(*batch, D)` where its motions end; None where that was not said.
        P: `(D, D)` or `(*batch, D, D)` of the condition that holds; None where that was not said.
        names: of the D inputs; empty where that was not said.
        units: of positions, such as "m"; "" where that was not said.
        dt: time step that it is meant for [s]; None where that was not said.
        versions: of the packages that wrote the file, by name; empty for a policy that comes from no file.
    """

    goal: Tensor | None = None
    P: Tensor | None = None
    names: tuple[str, ...] = ()
    units: str = ""
    dt: float | None = None
    versions: Mapping[str, str] = {}

    def part(self, index: int | slice | Tensor, n: int) -> Info:
        """What belongs to `policy[index]` of a policy with a batch of `n` dimensions."""
        goal = self.goal[index] if self.goal is not None and self.goal.ndim - 1 == n else self.goal
        P = self.P[index] if self.P is not None and self.P.ndim - 2 == n else self.P
        return self._replace(goal=goal, P=P)


def completed(
    info: Info, dim: int, goal: Array | None, P: Array | None, names: Sequence[str], units: str, dt: float | None
) -> Info:
    """`info` with what is given in place of what is not.

    Args:
        info: what was known.
        dim: D.
        goal: see `Info`, as are the others.
        P: not given where None.
        names: not given where empty.
        units: not given where empty.
        dt: not given where None.

    Raises:
        InvalidArgumentError: shapes or numbers that do not fit a policy of D inputs.
    """
    goal, P = (None if value is None else tensor(name, value) for name, value in (("goal", goal), ("P", P)))
    for name, value, shape in (("goal", goal, (dim,)), ("P", P, (dim, dim))):
        if value is not None and (tuple(value.shape[-len(shape) :]) != shape or not value.isfinite().all()):
            ends = ", ".join(map(str, shape))
            raise InvalidArgumentError(f"{name} has to be finite and end with ({ends}), got {shown(value)}")
    if isinstance(names, str) or (names and (len(names) != dim or not all(isinstance(name, str) for name in names))):
        raise InvalidArgumentError(f"names has to be one string for each of the {dim} inputs, got {names!r}")
    if not isinstance(units, str):
        raise InvalidArgumentError(f"units has to be a string such as 'm', got {units!r}")
    if dt is not None:
        check_positive("dt", dt)
    return Info(
        goal=info.goal if goal is None else goal,
        P=info.P if P is None else P,
        names=tuple(names) or info.names,
        units=units or info.units,
        dt=info.dt if dt is None else float(dt),
        versions=info.versions,
    )


def write(path: str | Path, values: Mapping[str, Tensor], info: Info) -> None:
    """Write the tensors of a policy by name, and what belongs to it, with the versions of now.

    Raises:
        FileError: see `torchds.files.write_atomically`.
    """
    content: dict[str, Any] = {"values": values, **info._asdict(), "names": list(info.names), "versions": versions()}
    files.save(path, KIND, _of_its_own(content), without_torch=True)


def read(path: str | Path) -> tuple[dict[str, Tensor], Info]:
    """What `write` wrote, verified; tensors come to the CPU.

    Raises:
        FileError: see `torchds.files.load`; or it is a policy of an earlier version.
    """
    content = files.load(path, KIND)
    if not isinstance(values := content.pop("values", None), dict) or set(content) != set(Info._fields):
        raise FileError(
            f"{path} is a policy of another version of this library: it does not hold {', '.join(('values', *Info._fields))}; "
            "make the policy again and write it with policy.save(path)"
        )
    return values, Info(**{**content, "names": tuple(content["names"])})


def _of_its_own(value: Any) -> Any:
    """The same with tensors that share no memory and own all of theirs."""
    if isinstance(value, Mapping):
        return {name: _of_its_own(item) for name, item in value.items()}
    return value.detach().cpu().clone(memory_format=torch.contiguous_format) if isinstance(value, Tensor) else value


def versions() -> dict[str, str]:
    """Of the packages that a file of a policy depends on."""
    itself = sys.modules[__name__.partition(".")[0]]  # what runs: a checkout may be newer than what was installed
    return {"torchds": itself.__version__, "torch": str(torch.__version__), "numpy": np.__version__}
