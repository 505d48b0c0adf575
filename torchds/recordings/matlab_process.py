"""Run as a program: read a MATLAB file and write its variables to the standard output, plainly.

Stability: experimental.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from typing import Any

import numpy as np

MEMORY = 8 * 2**30  # bytes of address space; a file that claims more is refused by the system
DEPTH = 50


def plain(value: Any, arrays: dict[str, np.ndarray], depth: int = 0) -> Any:
    """Numbers go into `arrays` under a name; text, cells and structs become what JSON has."""
    if depth > DEPTH:
        raise ValueError(f"nested more than {DEPTH} levels deep")
    if isinstance(value, np.ndarray) and value.dtype.names:
        items = [
            {"struct": [[name, plain(item[name], arrays, depth + 1)] for name in value.dtype.names]}
            for item in value.ravel()
        ]
        return items[0] if len(items) == 1 else items
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [plain(item, arrays, depth + 1) for item in value.ravel()]
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        arrays[name := f"a{len(arrays)}"] = value
        return {"array": name}
    return str(value.ravel()[0]) if isinstance(value, np.ndarray) and value.size == 1 else str(value)[:200]


def variables(path: str) -> dict[str, Any]:
    """The variables of a file as scipy has them.

    Raises:
        Exception: whatever scipy raises.
    """
    from scipy.io import loadmat

    contents: dict[str, Any] = loadmat(path, appendmat=False)
    return {name: value for name, value in contents.items() if not name.startswith("__")}


def main(path: str) -> int:
    """Exit with 0 and an archive, with 3 for version 7.3, or with 1 and a line of what went wrong."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    try:
        arrays: dict[str, np.ndarray] = {}
        tree = {name: plain(value, arrays) for name, value in variables(path).items()}
    except NotImplementedError:
        return 3
    except BaseException as error:
        print(f"{type(error).__name__}: {error}".splitlines()[0], file=sys.stderr)
        return 1
    buffer = io.BytesIO()
    np.savez(buffer, tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8), **arrays)  # type: ignore[arg-type]
    sys.stdout.buffer.write(buffer.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
