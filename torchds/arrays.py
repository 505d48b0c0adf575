"""Arrays that users give, as tensors: what is taken, and what is refused with the place of the fault.

Stability: experimental.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchds.errors import InvalidArgumentError, InvalidDemonstrationsError

Array = Tensor | ArrayLike


def tensor(where: str, value: Array) -> Tensor:
    """A copy as float32 or float64 tensor."""
    if isinstance(value, Tensor):
        keep = value.dtype in (torch.float32, torch.float64)
        real = not value.is_complex()
    else:
        try:
            array = np.asarray(value)
        except ValueError:
            array = np.empty(0, dtype=object)  # rows of different lengths
        real = array.dtype.kind in "biuf"
        keep = array.dtype == np.float32
        if real:
            value = torch.from_numpy(np.array(array, dtype=np.float32 if keep else np.float64, order="C"))
    if not real or not isinstance(value, Tensor):
        raise InvalidDemonstrationsError(
            f"{where} has to be an array of real numbers with rows of equal length, got {value!r:.60}"
        )
    return value.detach().to(value.dtype if keep else torch.float64, copy=True)


def tensors(what: str, arrays: Sequence[Array] | Tensor) -> list[Tensor]:
    """One (T, C) tensor per demonstration with equal C, dtype and device."""
    values = [tensor(f"{what} of demonstration {i}", array) for i, array in enumerate(arrays)]
    if not values:
        raise InvalidDemonstrationsError(f"{what} has to be at least one array (T, D), got none")
    for i, value in enumerate(values):
        if value.ndim != 2 or not value.shape[1]:
            raise InvalidDemonstrationsError(
                f"{what} of demonstration {i} has to be (T, D), samples in rows and dimensions in columns, got shape "
                f"{tuple(value.shape)}; a single demonstration is passed in a list, [{what}]"
            )
        if value.shape[1] != values[0].shape[1]:
            raise InvalidDemonstrationsError(
                f"{what} of demonstration {i} has to have the {values[0].shape[1]} columns of demonstration 0, got "
                f"{value.shape[1]}"
            )
    dtype = functools.reduce(torch.promote_types, [value.dtype for value in values])
    return [value.to(values[0].device, dtype) for value in values]


def shown(value: object) -> str:
    """What a user gave, in one short line."""
    line = " ".join(repr(value).split())
    return line if len(line) <= 80 else f"{line[:77]}..."


def like(name: str, value: Array, reference: Tensor) -> Tensor:
    """What a user gave as tensor of the dtype and on the device of `reference`; gradients pass.

    Raises:
        InvalidArgumentError: no array of real numbers.
    """
    if not isinstance(value, Tensor):
        try:
            array = np.asarray(value)
            value = torch.from_numpy(np.array(array, dtype=np.float64)) if array.dtype.kind in "biuf" else value
        except (TypeError, ValueError, RuntimeError):
            pass
    if not isinstance(value, Tensor) or value.is_complex() or value.is_meta != reference.is_meta:
        raise InvalidArgumentError(
            f"{name} has to be a tensor or an array of real numbers, got {shown(value)}; give torch.as_tensor(...)"
        )
    return value.to(reference.device, reference.dtype)


def real(name: str, value: Array, axes: str = "(...)") -> Tensor:
    """What a user gave as tensor: floating point tensors as they are, float32 arrays as such, all else as float64.

    Args:
        name: of the argument.
        value: that was given.
        axes: that it has to have, as in "(..., T, D)"; those behind the dots count.

    Raises:
        InvalidArgumentError: no array of real numbers, or one with fewer axes.
    """
    if not isinstance(value, Tensor) or not value.is_floating_point():
        single = isinstance(value, np.ndarray) and value.dtype == np.float32
        device = value.device if isinstance(value, Tensor) else None
        value = like(name, value, torch.empty(0, dtype=torch.float32 if single else torch.float64, device=device))
    if value.ndim < _least(axes):
        raise InvalidArgumentError(f"{name} has to be {axes}, got shape {tuple(value.shape)}")
    return value


@functools.cache
def _least(axes: str) -> int:
    """How many axes there are at least, from their names."""
    return sum(axis not in ("...", "") and axis[0] != "*" for axis in axes.strip("()").split(", "))


def beside(name: str, value: Array, reference: Tensor, axes: str, last: int = 1, *, grows: bool = True) -> Tensor:
    """What a user gave as tensor `like` another that it broadcasts with.

    Args:
        name: of the argument.
        value: that was given.
        reference: the other one.
        axes: of the value, in words.
        last: how many of the last axes have to be of equal size.
        grows: whether both together may be larger than the other one.

    Raises:
        InvalidArgumentError: no array of real numbers, or one that does not fit.
    """
    value = like(name, value, reference)
    try:
        fits = value.shape[value.ndim - last :] == reference.shape[reference.ndim - last :] and value.ndim >= last
        together = broadcast_shape(value.shape, reference.shape)
        fits = fits and (grows or together == tuple(reference.shape))
    except RuntimeError:
        fits = False
    if not fits:
        raise InvalidArgumentError(
            f"{name} has to be {axes} and fit {tuple(reference.shape)}, got shape {tuple(value.shape)}"
        )
    return value


def without_autocast(x: Tensor) -> AbstractContextManager[Any]:
    """A block in which matrix products on the device of `x` are as precise as their arguments, whatever is around it."""
    kind = x.device.type
    # Dynamo of torch < 2.13 stops at is_autocast_available.
    known = torch.compiler.is_compiling() or torch.amp.is_autocast_available(kind)
    return torch.autocast(kind, enabled=False) if known and torch.is_autocast_enabled(kind) else nullcontext()


def matching(what: str, arrays: Sequence[Array] | Tensor, positions: list[Tensor]) -> list[Tensor]:
    """As `tensors`, with as many rows as there are positions."""
    if len(arrays) != len(positions):
        raise InvalidDemonstrationsError(
            f"{what} has to be one array for each of the {len(positions)} demonstrations, got {len(arrays)}"
        )
    values = [value.to(positions[0]) for value in tensors(what, arrays)]
    for i, (x, value) in enumerate(zip(positions, values, strict=True)):
        if len(value) != len(x):
            raise InvalidDemonstrationsError(
                f"demonstration {i}: {what} has to have the {len(x)} rows of x, got shape {tuple(value.shape)}; "
                "give one row per position"
            )
    return values


def check_labels(dim: int, names: Sequence[str], units: Sequence[str]) -> None:
    """Refuse names and units that are not one per dimension, and names that are given twice."""
    for what, labels in (("names", names), ("units", units)):
        if len(labels) != dim:
            raise InvalidArgumentError(f"{what} has to be one for each of the {dim} dimensions, got {labels}")
    if len(set(names)) < dim:
        raise InvalidArgumentError(f"names has to be a different one for each dimension, got {names}")


def check_finite(values: list[Tensor], columns: Sequence[str]) -> None:
    """Refuse values `(T, C)` that are not finite, with row and column of the first."""
    for i, value in enumerate(values):
        bad = (~value.isfinite()).nonzero()
        if len(bad):
            row, column = bad[0].tolist()
            raise InvalidDemonstrationsError(
                f"demonstration {i}, row {row} (counted from 0), column {columns[column]!r}: "
                f"all values have to be finite, got {value[row, column].item()}; remove the row or fill it in"
            )


def check_count(name: str, value: int, minimum: int) -> None:
    """Refuse what is no integer of at least `minimum`."""
    try:
        fits = operator.index(value) >= minimum
    except TypeError:
        fits = False
    if not fits:
        raise InvalidArgumentError(f"{name} has to be an integer of at least {minimum}, got {value!r}")


def number(name: str, value: Any, allowed: str, fits: Callable[[float], bool]) -> float:
    """A number as float, from any type of numbers.

    Args:
        name: of the argument.
        value: that was given.
        allowed: what `fits` means, in words.
        fits: whether the number is allowed.

    Raises:
        InvalidArgumentError: no number, or one that does not fit.
    """
    try:
        found = math.nan if isinstance(value, str) else float(value)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        found = math.nan
    if not fits(found):
        raise InvalidArgumentError(f"{name} has to be {allowed}, got {shown(value)}")
    return found


def count(name: str, value: Any, minimum: int) -> int:
    """A whole number of at least `minimum` as int, from any type of numbers.

    Raises:
        InvalidArgumentError: something else.
    """
    number(name, value, f"at least {minimum}", lambda n: math.isnan(n) or n >= minimum)
    return int(number(name, value, f"a whole number of at least {minimum}", lambda n: math.isfinite(n) and n == int(n)))


def check_positive(name: str, value: float) -> None:
    """Refuse what is not positive and finite."""
    if not 0 < value < math.inf:
        raise InvalidArgumentError(f"{name} has to be positive and finite, got {value!r}")


def vector(name: str, value: Array) -> Tensor:
    """A finite (C,) tensor, of one number too."""
    vector = tensor(name, value)
    vector = vector if vector.ndim else vector.reshape(1)
    if vector.ndim != 1 or not len(vector) or not vector.isfinite().all():
        raise InvalidArgumentError(f"{name} has to be one row of finite numbers, got {value!r}")
    return vector


def per_demonstration(
    name: str, value: float | Sequence[float] | np.ndarray, n: int, error: type[Exception] = InvalidArgumentError
) -> list[float]:
    """One number for each of `n` demonstrations, from one for all or one each."""
    try:
        steps = np.asarray(value, dtype=float).ravel().tolist()
    except (TypeError, ValueError):
        raise error(f"{name} has to be a number [s], or one for each demonstration, got {value!r}") from None
    if len(steps) not in (1, n):
        raise error(
            f"{name} has to be one value for all or one for each of the {n} demonstrations, got {len(steps)} values"
        )
    return steps * n if len(steps) == 1 else steps


def of_one_dtype(given: Mapping[str, Any], *, optional: Collection[str] = (), finite: Collection[str] = ()) -> Any:
    """Arrays by name as tensors of the widest dtype among the tensors, float64 where there is none.

    Raises:
        InvalidArgumentError: no array of real numbers, None for one that is not `optional`, or one of those in `finite` that is
            not.
    """
    kinds = [value.dtype for value in given.values() if isinstance(value, Tensor) and value.is_floating_point()]
    dtype = functools.reduce(torch.promote_types, kinds) if kinds else torch.float64
    device = next((value.device for value in given.values() if isinstance(value, Tensor)), torch.device("cpu"))
    reference = torch.empty(0, dtype=dtype, device=device)
    left_out = {name for name, value in given.items() if value is None and name in optional}
    tensors = {name: None if name in left_out else like(name, value, reference) for name, value in given.items()}
    for name in finite:
        value = tensors[name]
        if value is not None and not value.isfinite().all():
            raise InvalidArgumentError(f"{name} has to be finite, got NaN or infinity in {shown(value)}")
    return tensors.values()


def over(name: str, value: Array, reference: Tensor, axes: str, last: int = 1) -> Tensor:
    """What a user gave as tensor of the shape of another: `beside` it, and not larger."""
    return beside(name, value, reference, axes, last, grows=False).expand_as(reference)


def broadcast_shape(*shapes: Sequence[int]) -> tuple[int, ...]:
    """The shape that tensors of these shapes broadcast to; that of torch imports sympy, which takes half a second.

    Raises:
        RuntimeError: they do not broadcast.
    """
    found = [1] * max([len(shape) for shape in shapes])
    for shape in shapes:
        for i in range(-1, -len(shape) - 1, -1):
            if shape[i] != 1:
                if found[i] != 1 and found[i] != shape[i]:  # sizes may be symbols, which `in` does not compare
                    raise RuntimeError(f"shapes {[tuple(each) for each in shapes]} do not broadcast")
                found[i] = shape[i]
    return tuple(found)


def transformed(matrix: Tensor, vectors: Tensor) -> Tensor:
    """`matrix` `(*batch, P, P)` times each of `vectors` `(*lead, *batch, P)`: one product, not a matrix for each of `lead`."""
    columns = vectors.reshape(-1, *matrix.shape[:-1]).movedim(0, -1)
    return (matrix @ columns).movedim(-1, 0).reshape(vectors.shape)
