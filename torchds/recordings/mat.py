"""MATLAB files of demonstrations.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, UnknownNameError
from torchds.recordings.arrays import (
    apart,
    by_name,
    chosen,
    finished,
    names_said,
    place,
    upright,
    with_halves,
    without_clock,
)
from torchds.recordings.base import Recorded, canonical, group, together
from torchds.recordings.matlab import read_variables
from torchds.recordings.parts import Record
from torchds.recordings.reading import Reading, check


def load_mat(path: str | Path, **how: Unpack[Reading]) -> Demonstrations:
    """Demonstrations from a MATLAB file (version 7 or older), which is read in a process of its own.

    They may be a cell array of matrices or of structs, an array of structs, one matrix, one array of three axes, or one array
    per demonstration named as for `load_npz`, in cells and structs at any depth. The fields of a struct are `x` or `pos` or
    `position(s)`; `v`, `vel` or `velocity`; `stiffness`; `t` or `time` and `dt` [s]; the arguments may name others. The longer
    axis of a matrix is time. Where the second half of the columns of all matrices is the derivative of the first, it holds
    the velocities.

    Args:
        path: the file.
        **how: see `Reading`.

    Raises:
        FileError: the file is missing, is no such file, has no usable variable or several, or it cannot be told which axis
            is time.
        UnknownNameError: there is no variable of that name.
        InvalidArgumentError: an argument out of its range.
    """
    return together([recorded(path, how)], how)


def recorded(path: str | Path, how: Reading) -> Recorded:
    """What a file holds."""
    check(how)
    return in_variables(Path(path), read_variables(path), how)


def in_variables(path: Path, contents: Mapping[str, Any], how: Reading) -> Recorded:
    """What the variables of a file hold."""
    variable = how.get("variable")
    if variable is not None and variable not in contents:
        raise UnknownNameError(f"variable in {path.name}", variable, contents)
    raw, bare = _records(path, contents if variable is None else {variable: contents[variable]}, how)
    pieces = [piece for i, record in enumerate(raw) for piece in apart(place(path, i), record, how)]
    turned = [upright(place(path, i), piece, how, longer=True) for i, piece in enumerate(pieces)]
    shared = contents.get("dt")
    shared = shared if isinstance(shared, np.ndarray) and shared.dtype.kind in "fiu" else None
    if bare:
        without_clock(str(path), turned, how)
    turned = [chosen(place(path, i), record, how) for i, record in enumerate(turned)]
    if bare:
        turned = with_halves(turned, _steps(len(turned), shared, how), how)
    records = [part for i, record in enumerate(turned) for part in finished(place(path, i), record, how)]
    return Recorded(path, records, shared)


def _steps(n: int, shared: np.ndarray | None, how: Reading) -> list[float | None]:
    """The time step of each of n matrices, where it is known."""
    said = np.asarray(how.get("dt") if shared is None else shared, dtype=object).ravel().tolist()
    steps = [None if step is None else float(step) for step in said]
    return steps if len(steps) == n else steps * n if len(steps) == 1 else [None] * n


def _records(path: Path, contents: Mapping[str, Any], how: Reading) -> tuple[list[Record], bool]:
    """The records of the one variable that can be meant, and whether they are matrices without names.

    Cells and structs come before arrays by name, these before any matrix.
    """
    if said := names_said(how):
        return _by_name(path, contents, said), False
    usable = {key: records for key, value in contents.items() if (records := _cells(value))}
    nested = {key: records for key, records in usable.items() if not isinstance(contents[key], np.ndarray)}
    if not nested and (groups := group(key for key, value in contents.items() if isinstance(value, np.ndarray))):
        named = [canonical({alias: contents[key] for alias, key in keys.items()}) for keys in groups]
        for i, record in enumerate(named):
            if "x" not in record:
                raise FileError(f"{place(path, i)} has no positions; give them in all demonstrations, or in none")
        return named, False
    found = nested or usable
    if len(found) == 1:
        ((key, records),) = found.items()
        return records, not _structs(contents[key])
    listing = "; ".join(f"{key}: {_describe(contents[key])}" for key in sorted(contents)) or "nothing"
    if found:
        raise FileError(
            f"{path}: {' and '.join(sorted(found))} could be meant; choose with variable= (the file holds {listing})"
        )
    inner = sorted({name for value in contents.values() for struct in _structs(value) for name in struct})
    advice = f"; say which field holds the positions, positions={_likeliest(inner)!r}" if inner else ""
    raise FileError(
        f"{path}: no usable variable; wanted is a cell array of matrices or of structs with a field x or pos, or "
        f"matrices x0, x1, ...; found: {listing}{advice}"
    )


def _likeliest(fields: list[str]) -> str:
    """The field that sounds most like positions, else the first."""
    sounding = [
        name for name in fields if any(word in name.lower() for word in ("pos", "traj", "data", "joint", "cart"))
    ]
    return (sounding or fields)[0]


def _by_name(path: Path, contents: Mapping[str, Any], said: Mapping[str, list[str]]) -> list[Record]:
    """The records of all structs, at any depth, that have the fields that were named; else those of the variables."""
    structs = [struct for value in contents.values() for struct in _structs(value)]
    found = [record for struct in structs for record in _renamed(struct, said)] or _renamed(contents, said)
    names = [name for each in said.values() for name in each]
    if not found:
        known = sorted({name for struct in structs for name in struct} | set(contents))
        raise UnknownNameError(f"field in {path.name}", next((n for n in names if n not in known), names[0]), known)
    for i, record in enumerate(found):
        if missing := [each[0] for field, each in said.items() if field not in record]:
            raise FileError(f"{place(path, i)} has no field {missing[0]!r} beside its positions")
    return found


def _renamed(struct: Mapping[str, Any], said: Mapping[str, list[str]]) -> list[Record]:
    """The records of a struct, its arrays as x, v, stiffness, t, dt: as the arguments say, else by their usual names."""
    arrays = {key: value for key, value in struct.items() if isinstance(value, np.ndarray)}
    usual = {field: value for field, value in canonical(arrays).items() if field not in said}
    there = {field: each for field, names in said.items() if (each := [name for name in names if name in arrays])}
    found = [{**usual, **record} for record in by_name(arrays, there)] if there else [usual]
    return [record for record in found if "x" in record]


def _structs(value: Any) -> list[dict[str, Any]]:
    """All structs in a variable, the outer ones first."""
    if isinstance(value, list):
        return [struct for item in value for struct in _structs(item)]
    if isinstance(value, dict):
        return [value, *(struct for item in value.values() for struct in _structs(item))]
    return []


def _cells(value: Any) -> list[Record]:
    """One record per demonstration in a MATLAB variable; [] if it is of no use."""
    if isinstance(value, dict):
        fields = {name: item for name, item in value.items() if isinstance(item, np.ndarray)}
        if "x" in (record := canonical(fields)):
            return [record]
        inner = [records for item in value.values() if isinstance(item, (dict, list)) and (records := _cells(item))]
        return inner[0] if len(inner) == 1 else []
    if isinstance(value, list):
        parts = [_cells(item) for item in value]
        return [record for part in parts for record in part] if all(parts) else []
    numeric = isinstance(value, np.ndarray) and value.dtype.kind in "biuf"
    return [{"x": value}] if numeric and value.ndim in (2, 3) and value.size > 1 else []


def _describe(value: Any) -> str:
    if isinstance(value, dict):
        return f"1 x 1 struct of {', '.join(value)}"
    if isinstance(value, list):
        inner = next((f", each a struct of {', '.join(item)}" for item in value if isinstance(item, dict)), "")
        return f"1 x {len(value)} cell{inner}"
    if isinstance(value, np.ndarray):
        return f"{' x '.join(map(str, value.shape))} {value.dtype.name}"
    return "1 str"
