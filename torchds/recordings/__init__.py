"""Readers of recorded motions: LASA, tables in text files, .npz and .mat files become `Demonstrations`.

Letters: `T` samples, `D` dimensions, `Q` stiffness columns.

Stability: stable.
"""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, InvalidArgumentError
from torchds.files import existing
from torchds.recordings import mat, npz
from torchds.recordings.base import together
from torchds.recordings.csv import SUFFIXES as _TABLES
from torchds.recordings.csv import load_csv as load_csv
from torchds.recordings.csv import read_table as read_table
from torchds.recordings.lasa import lasa_names as lasa_names
from torchds.recordings.lasa import load_lasa as load_lasa
from torchds.recordings.mat import load_mat as load_mat
from torchds.recordings.npz import load_npz as load_npz
from torchds.recordings.reading import Reading as Reading

__all__ = ["Reading", "lasa_names", "load", "load_csv", "load_lasa", "load_mat", "load_npz", "read_table"]


def load(paths: str | Path | Sequence[str | Path], **how: Unpack[Reading]) -> Demonstrations:
    """Demonstrations from .csv, .txt, .npz or .mat files; several files are read one after the other.

    `load_csv`, `load_npz` and `load_mat` say what a file may hold and what is refused; docs/data.md has a table of forms
    and calls.

    Args:
        paths: a file, a folder, a pattern such as `"recordings/*.mat"`, or a sequence of files of one kind.
        **how: what the files do not say themselves, see `Reading`.

    Raises:
        FileError: there is no such file, its suffix is another, or it cannot be read.
    """
    files = _files(paths)
    kinds = sorted({path.suffix.lower() for path in files})
    if set(kinds) <= set(_TABLES):
        return load_csv(files, **how)
    if len(kinds) > 1:
        raise FileError(
            f"{paths}: files of several kinds, {', '.join(kinds)}; choose with a pattern, such as "
            f"{str(Path(str(paths)) / ('*' + kinds[0])) if isinstance(paths, (str, Path)) else '*' + kinds[0]!r}"
        )
    if kinds == [".npz"]:
        return together([npz.recorded(path, how) for path in files], how)
    if kinds == [".mat"]:
        return together([mat.recorded(path, how) for path in files], how)
    raise FileError(
        f"{files[0]}: cannot tell what kind of file this is; known are .csv, .txt, .npz, .mat and a folder of one of them"
    )


def _files(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """The files that are meant, those of a folder or pattern in the order of their names."""
    if not isinstance(paths, (str, Path)):
        if not paths:
            raise InvalidArgumentError("paths has to be a file, a folder, a pattern, or several files, got none")
        return [existing(path) for path in paths]
    if any(sign in str(paths) for sign in "*?[") and not Path(paths).exists():
        found = sorted(Path(name) for name in glob.glob(str(paths)) if Path(name).is_file())
        if not found:
            raise FileError(f"{paths}: no file matches this pattern")
        return found
    if "\0" in str(paths) or not Path(paths).is_dir():
        return [existing(paths)]
    known = (*_TABLES, ".npz", ".mat")
    by_kind: dict[str, list[Path]] = {}
    for path in sorted(Path(paths).iterdir()):
        if path.suffix.lower() in known and path.is_file():
            by_kind.setdefault(path.suffix.lower(), []).append(path)
    if not by_kind:
        raise FileError(f"{paths}: no .csv file in this folder, nor another of {', '.join(known[1:])}")
    return by_kind[".csv"] if ".csv" in by_kind else [path for files in by_kind.values() for path in files]
