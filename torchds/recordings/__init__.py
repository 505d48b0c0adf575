"""Readers of recorded motions: LASA, .csv, .npz and .mat files become `Demonstrations`.

Letters: `T` samples, `D` dimensions, `Q` stiffness columns.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError
from torchds.recordings.csv import load_csv as load_csv
from torchds.recordings.csv import read_table as read_table
from torchds.recordings.lasa import lasa_names as lasa_names
from torchds.recordings.lasa import load_lasa as load_lasa
from torchds.recordings.mat import load_mat as load_mat
from torchds.recordings.npz import load_npz as load_npz

__all__ = ["lasa_names", "load", "load_csv", "load_lasa", "load_mat", "load_npz", "read_table"]


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
        FileError: there is no such file, its suffix is another, or it cannot be read.
    """
    path = Path(path)
    if path.is_dir() or path.suffix.lower() == ".csv":
        return load_csv(path, dt=dt, names=names, units=units)
    if path.suffix.lower() == ".npz":
        return load_npz(path, dt=dt, names=names, units=units)
    if path.suffix.lower() == ".mat":
        return load_mat(path, dt=dt, names=names, units=units)
    raise FileError(
        f"{path}: cannot tell what kind of file this is; known are .csv, .npz, .mat and a folder of .csv files"
    )
