"""Which backend there is, and which one is meant.

Stability: experimental.
"""

from __future__ import annotations

import functools
import importlib
import os
from typing import Literal

import torch

from torchds.errors import InvalidArgumentError

Backend = Literal["auto", "eager", "fused", "scan"]

MISSING = {
    "cpu": "there is no numba here, install it with: pip install 'torchds[fast]'",
    "cuda": "there is no triton for this GPU here, install it with: pip install 'torchds[gpu]'",
}


class Unfit(Exception):
    """Why something cannot run in compiled code."""


def available() -> dict[str, bool]:
    """Which fused backends this machine has: "cpu" needs the package numba, "cuda" a GPU and the package triton."""
    return {device: has(device) for device in ("cpu", "cuda")}


@functools.cache
def has(device: str) -> bool:
    """Whether there are kernels for a type of device."""
    if device not in ("cpu", "cuda") or (device == "cuda" and not torch.cuda.is_available()):
        return False
    try:
        module = importlib.import_module(f"torchds.kernels.{device}")
        if device == "cuda":
            module.ready()
    except (ImportError, RuntimeError):  # not installed, or not for this numpy; no C compiler for Triton
        return False
    return True


def wanted(backend: Backend) -> Literal["auto", "eager", "fused", "scan"]:
    """What `backend` means here and now; "auto" is "scan" while a program is compiled or exported.

    Raises:
        InvalidArgumentError: an unknown backend.
    """
    if torch.compiler.is_compiling():  # a kernel is no part of a graph
        return "scan" if backend == "auto" else backend
    if backend == "auto":
        backend = os.environ.get("TORCHDS_BACKEND", "auto")  # type: ignore[assignment]
    if backend not in ("auto", "eager", "fused", "scan"):
        raise InvalidArgumentError(f"backend has to be 'auto', 'eager', 'fused' or 'scan', got {backend!r}")
    if backend == "auto" and not has("cpu") and not has("cuda"):
        return "eager"
    return backend


def cannot(reason: object) -> InvalidArgumentError:
    """The error of a fused backend that was asked for where it cannot be."""
    return InvalidArgumentError(f"backend='fused' cannot make this roll-out: {reason}; backend='auto' makes it eagerly")
