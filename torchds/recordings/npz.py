"""NumPy archives of demonstrations.

Stability: stable.
"""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, UnknownNameError
from torchds.files import read_npz
from torchds.recordings.arrays import apart, by_name, chosen, finished, names_said, place, upright
from torchds.recordings.base import Recorded, canonical, group, together
from torchds.recordings.parts import Record
from torchds.recordings.reading import Reading, check


def load_npz(path: str | Path, **how: Unpack[Reading]) -> Demonstrations:
    """Demonstrations from a NumPy archive with one (T, D) array per demonstration, or one of three axes.

    Positions are called `demo0_x` (or `demo0_pos`), `demo1_x`, ... or `x0`, `x1`, ...; velocities, stiffness and time
    likewise: `demo0_v` (`demo0_vel`), `demo0_stiffness`, `demo0_t`; the arguments may name others. `dt` is one number or one
    per demonstration. Where velocities are one sample shorter than positions, as forward differences are, the last position
    is dropped.

    Args:
        path: the file.
        **how: see `Reading`.

    Raises:
        FileError: the file is missing, is no such archive, or its arrays cannot be used.
        UnknownNameError: an array that is not there.
    """
    return together([recorded(path, how)], how)


def recorded(path: str | Path, how: Reading) -> Recorded:
    """What an archive holds."""
    check(how, without=("variable",))
    arrays = read_npz(path)
    path = Path(path)
    if said := names_said(how):
        for name in (name for names in said.values() for name in names):
            if name not in arrays:
                raise UnknownNameError(f"array in {path.name}", name, arrays)
        raw: list[Record] = by_name(arrays, said)
    else:
        raw = [canonical({alias: arrays[key] for alias, key in keys.items()}) for keys in group(arrays)]
    if not raw:
        raise FileError(
            f"{path}: no positions; name them demo0_x, demo1_x, ... or x0, x1, ..., or say which arrays they are, "
            f"positions=('...',) (the file has {', '.join(arrays) or 'nothing'})"
        )
    if odd := [key for key in ("names", "units") if key in arrays and arrays[key].ndim != 1]:
        raise FileError(f"{path}: {odd[0]} has to be one for each dimension, got shape {arrays[odd[0]].shape}")
    names, units = ([str(item) for item in arrays[key]] if key in arrays else None for key in ("names", "units"))
    dim = None if names is None else len(names)
    records: list[Record] = []
    for i, record in enumerate(raw):
        if "x" not in record:
            raise FileError(f"{place(path, i)} has no positions; give them in all demonstrations, or in none")
        for piece in apart(place(path, i), record, how):
            turned = upright(place(path, len(records)), piece, how, longer=False, dim=dim)
            records += finished(place(path, len(records)), chosen(place(path, len(records)), turned, how), how)
    return Recorded(path, records, arrays.get("dt"), names, units)
