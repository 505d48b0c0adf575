"""How functions are compiled, the gating that all of them share, and the threads that they run in.

Numba looks at the file of a function to see whether what it keeps on disk is still right, not at the files of what that calls:
whoever changes this file while working on it empties `torchds/kernels/__pycache__`.

Stability: experimental.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def compiled(function: Callable[..., Any]) -> Any:
    """`function`, compiled when it is first called; the code is kept on disk where there is a place for it."""
    try:
        return numba.njit(cache=True, **OPTIONS)(function)
    except RuntimeError:  # numba found no folder that it may write to
        return numba.njit(**OPTIONS)(function)


@functools.partial(numba.njit, inline="always")  # a call would cost half of a step
def activate(axes, x, shift, center, factors, offset, log_scale, limit, h):
    """Write h_k(x − shift) of Eq. 2 to `h`."""
    D, K = len(axes), len(h)
    highest, far = -np.inf, False
    for d in range(D):
        if not abs((x[d] - shift[d]) - center[d]) <= limit:
            far = True
    for k in range(K):
        square = 0.0
        for j in range(D):
            a = offset[k * D + j] + 0.0
            for d in range(D):
                a += factors[k, j, d] * ((x[d] - shift[d]) - center[d])
            square += a * a
        if far or not square <= limit * limit:  # or not a number: again, each distance cut so that its square is finite
            square = 0.0
            for j in range(D):
                a = offset[k * D + j] + 0.0
                for d in range(D):
                    b = (x[d] - shift[d]) - center[d]
                    if b > limit:
                        b = limit
                    elif b < -limit:
                        b = -limit
                    a += factors[k, j, d] * b
                if a > limit:
                    a = limit
                elif a < -limit:
                    a = -limit
                square += a * a
        exponent = log_scale[k] - 0.5 * square
        h[k] = exponent
        if exponent > highest:
            highest = exponent
    total = 0.0
    for k in range(K):
        e = math.exp(h[k] - highest)
        h[k] = e
        total += e
    scale = 1.0 / total
    for k in range(K):
        h[k] *= scale


MANY = 100_000  # time steps from which on a second thread pays


@functools.cache
def _pool(n_threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(n_threads, thread_name_prefix="torchds")


if hasattr(os, "register_at_fork"):  # a forked process has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def in_threads(kernel: Any, n: int, n_steps: int, n_threads: int, *arguments: Any) -> None:
    """Call `kernel(first, last, *arguments)` for all of `n` roll-outs, in several threads where that pays."""
    n_threads = min(n_threads, n)
    if n_threads < 2 or n * n_steps < MANY:
        kernel(0, n, *arguments)
        return
    edges = [n * j // n_threads for j in range(n_threads + 1)]
    calls = [_pool(n_threads).submit(kernel, *edges[j : j + 2], *arguments) for j in range(n_threads)]
    for call in calls:
        call.result()
