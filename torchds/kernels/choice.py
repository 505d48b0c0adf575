"""Which backend there is, and which one is meant.

Stability: experimental.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
from typing import Literal

import torch

from torchds.errors import InvalidArgumentError

Backend = Literal["auto", "eager", "fused", "scan"]


class Unfit(Exception):
    """Why something cannot run in compiled code."""


def available() -> dict[str, bool]:
    """Which fused backends this machine has: "cpu" needs the package numba, "cuda" a GPU and the package triton."""
    return {"cpu": _has_numba(), "cuda": torch.cuda.is_available() and importlib.util.find_spec("triton") is not None}


@functools.cache
def _has_numba() -> bool:
    try:
        importlib.import_module("torchds.kernels.cpu")
    except ImportError:  # not installed, or not for this numpy
        return False
    return True


def wanted(backend: Backend) -> Literal["auto", "eager", "fused", "scan"]:
    """What `backend` means here and now; "auto" is "scan" while a program is compiled or exported.

    Raises:
        InvalidArgumentError: an unknown backend, or one that cannot be had.
    """
    if torch.compiler.is_compiling():  # a kernel is no part of a graph
        return "scan" if backend == "auto" else backend
    if backend == "auto":
        backend = os.environ.get("TORCHDS_BACKEND", "auto")  # type: ignore[assignment]
    if backend not in ("auto", "eager", "fused", "scan"):
        raise InvalidArgumentError(f"backend has to be 'auto', 'eager', 'fused' or 'scan', got {backend!r}")
    if backend == "auto" and not _has_numba():
        return "eager"
    if backend == "fused" and not _has_numba():
        raise cannot("there is no numba here, install it with: pip install 'torchds[fast]'")
    return backend


def cannot(reason: object) -> InvalidArgumentError:
    """The error of a fused backend that was asked for where it cannot be."""
    return InvalidArgumentError(f"backend='fused' cannot make this roll-out: {reason}; backend='auto' makes it eagerly")
