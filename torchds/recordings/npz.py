"""NumPy archives of demonstrations.

Stability: stable.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchds.demonstrations import Demonstrations
from torchds.errors import FileError
from torchds.recordings.base import canonical, existing, from_records, group


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
        FileError: the file is missing, is no such archive, or its arrays cannot be used.
    """
    path = existing(path)
    if not zipfile.is_zipfile(path):
        raise FileError(f"{path}: not a .npz archive; write one with save_npz() or numpy.savez")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            groups = group(archive.files)
            raw = [{alias: archive[key] for alias, key in keys.items()} for keys in groups]
            found = list(archive.files)
            extra = {key: archive[key] for key in ("dt", "names", "units") if key in found}
    except Exception as error:  # numpy, zipfile and zlib raise many kinds
        raise FileError(f"{path}: not a readable .npz archive ({error})") from error
    if not raw:
        raise FileError(
            f"{path}: no positions; name them demo0_x, demo1_x, ... or x0, x1, ... (the file has {', '.join(found)})"
        )
    names = [str(name) for name in extra["names"]] if names is None and "names" in extra else names
    units = [str(unit) for unit in extra["units"]] if units is None and "units" in extra else units
    return from_records(
        path, [canonical(record) for record in raw], shared=extra.get("dt"), dt=dt, names=names, units=units
    )
