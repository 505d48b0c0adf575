"""The variables of a MATLAB file, read in a process of its own: a damaged file can end an interpreter.

The other process writes plain arrays and how they are nested; nothing of it is run here.

Stability: experimental.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from torchds.errors import FileError
from torchds.files import existing

SECONDS = 120  # that reading one file may take
CODE = Path(__file__).with_name("matlab_process.py")


def read_variables(path: str | Path) -> dict[str, Any]:
    """Variables by name: numbers as arrays, text as strings, cells as lists, structs as dicts (arrays of structs as lists).

    Raises:
        FileError: no such file, no such kind of file, a damaged one, or one of version 7.3.
    """
    path = existing(path)
    # -P: this folder has a csv.py, which is not the one of Python
    command = [sys.executable, "-P", str(CODE), str(path.resolve())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired as error:
        raise FileError(f"{path}: not a readable MATLAB file (it is not read within {SECONDS} s)") from error
    if done.returncode == 3:
        raise FileError(f"{path}: a MATLAB 7.3 file; save it again in MATLAB with the option -v7")
    if done.returncode != 0:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        raise FileError(f"{path}: not a readable MATLAB file ({said[-1] if said else 'the reader crashed'})")
    try:
        with np.load(io.BytesIO(done.stdout), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: not a readable MATLAB file (its reader was interrupted)") from error
    tree = json.loads(arrays.pop("tree").tobytes())
    return {name: restore(value, arrays) for name, value in tree.items()}


def restore(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """What `matlab_process.plain` took apart."""
    if isinstance(value, dict) and "array" in value:
        return arrays[value["array"]]
    if isinstance(value, dict):
        return {name: restore(item, arrays) for name, item in value["struct"]}
    return [restore(item, arrays) for item in value] if isinstance(value, list) else value
