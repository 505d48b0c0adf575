"""MATLAB files of demonstrations.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.recordings.base import Record, canonical, existing, from_records, group


def load_mat(
    path: str | Path,
    *,
    variable: str | None = None,
    time_axis: int | None = None,
    dt: float | Sequence[float] | None = None,
    names: Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
) -> Demonstrations:
    """Demonstrations from a MATLAB file (version 7 or older).

    They may be a cell array of matrices or of structs, an array of structs, one matrix, or one array per demonstration
    named as for `load_npz`. The fields of a struct are `x` or `pos` or `position(s)`; `v`, `vel` or `velocity`;
    `stiffness`; `t` or `time` and `dt` [s]; others are ignored.

    Args:
        path: the file.
        variable: the variable to read, needed if several could be meant.
        time_axis: 0 if samples are rows of the matrices, 1 if they are columns; by default the longer axis is time.
        dt: time step [s], needed if the file has none; one for all or one per demonstration.
        names: names of the dimensions.
        units: units of the dimensions.

    Raises:
        FileError: the file is missing, is no such file, has no usable variable or several, or a matrix is
            square and `time_axis` is not given.
        UnknownNameError: there is no variable of that name.
        InvalidArgumentError: `time_axis` is neither 0 nor 1.
    """
    if time_axis not in (None, 0, 1):
        raise InvalidArgumentError(
            f"time_axis has to be 0 (samples are rows) or 1 (samples are columns), got {time_axis!r}"
        )
    from scipy.io import loadmat

    path = existing(path)
    try:
        contents = loadmat(path, appendmat=False)
    except NotImplementedError as error:
        raise FileError(f"{path}: a MATLAB 7.3 file; save it again in MATLAB with the option -v7") from error
    except Exception as error:  # scipy raises many kinds
        raise FileError(f"{path}: not a readable MATLAB file ({error})") from error
    contents = {key: value for key, value in contents.items() if not key.startswith("__")}
    if variable is not None and variable not in contents:
        raise UnknownNameError(f"variable in {path.name}", variable, contents)
    raw = _mat_records(path, contents if variable is None else {variable: contents[variable]})
    records = [_upright(path, i, canonical(record), time_axis) for i, record in enumerate(raw)]
    return from_records(path, records, shared=contents.get("dt"), dt=dt, names=names, units=units)


def _cells(value: object) -> list[Record]:
    """One record per demonstration in a MATLAB variable; [] if it is of no use."""
    if not isinstance(value, np.ndarray) or not value.size:
        return []
    if value.dtype.names:
        records: list[Record] = [{name: item[name] for name in value.dtype.names} for item in value.ravel()]
        return records if all("x" in canonical(record) for record in records) else []
    if value.dtype == object:
        parts = [_cells(item) for item in value.ravel()]
        return [record for part in parts for record in part] if all(parts) else []
    return [{"x": value}] if value.ndim == 2 and value.size > 1 and value.dtype.kind in "biuf" else []


def _mat_records(path: Path, contents: Mapping[str, np.ndarray]) -> list[Record]:
    """The records of the one variable that can be meant: cells and structs before arrays by name before any matrix."""
    usable = {key: records for key, value in contents.items() if (records := _cells(value))}
    nested = {key: records for key, records in usable.items() if contents[key].dtype.kind in "OV"}
    if not nested and (groups := group(contents)):
        return [{alias: contents[key] for alias, key in keys.items()} for keys in groups]
    chosen = nested or usable
    if len(chosen) == 1:
        return next(iter(chosen.values()))
    listing = "; ".join(f"{key}: {_describe(contents[key])}" for key in sorted(contents)) or "nothing"
    if chosen:
        raise FileError(
            f"{path}: {' and '.join(sorted(chosen))} could be meant; choose with variable= (the file holds {listing})"
        )
    raise FileError(
        f"{path}: no usable variable; wanted is a cell array of matrices or of structs with a field x or pos, or "
        f"matrices x0, x1, ...; found: {listing}"
    )


def _describe(value: np.ndarray) -> str:
    size = " x ".join(map(str, value.shape))
    if value.dtype.names:
        return f"{size} struct of {', '.join(value.dtype.names)}"
    return f"{size} {'cell' if value.dtype == object else value.dtype.name}"


def _upright(path: Path, i: int, record: Record, time_axis: int | None) -> Record:
    """The record with time along the first axis of its matrices."""
    shape = record["x"].shape if "x" in record else ()
    if time_axis is None and len(shape) == 2:
        if shape[0] == shape[1]:
            raise FileError(
                f"{path}: the positions of demonstration {i} are {shape[0]} x {shape[1]}: either axis could be "
                "time; pass time_axis=0 (samples are rows) or time_axis=1 (samples are columns)"
            )
        time_axis = int(shape[1] > shape[0])
    return {key: value.T if time_axis == 1 and key not in ("t", "dt") else value for key, value in record.items()}
