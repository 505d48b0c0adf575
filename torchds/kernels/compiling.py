"""How loops are compiled, where compiled code is kept, and the threads that it runs in.

Stability: experimental.
"""

from __future__ import annotations

import functools
import hashlib
import os
import types
from collections import Counter
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from torchds.errors import MissingPackageError

try:
    import numba
except ImportError as error:  # not installed, or not for this numpy
    raise MissingPackageError("numba", "fast", "compiled code") from error

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
SOURCES = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()
MANY = 100_000  # time steps that are worth a second thread, or code for their sizes alone

Form = tuple[Hashable, ...]
"""What the types of a loop's arguments depend on."""


def compiled(function: Callable[..., Any]) -> Any:
    """`function`, compiled when it is first called."""
    return numba.njit(**OPTIONS)(function)


def piece(function: Callable[..., Any]) -> Any:
    """`function` as a part of compiled loops, with which it is compiled."""
    return numba.njit(forceinline=True, **OPTIONS)(function)


_jitted: dict[Hashable, Any] = {}


def jitted(function: Any) -> Any:
    """A user's function as compiled code calls it; what each call of `scalar_step` makes of the same code is one function."""
    if hasattr(function, "py_func"):
        return function
    inside = tuple(cell.cell_contents for cell in function.__closure__ or ())
    named = tuple(function.__globals__.get(name) for name in function.__code__.co_names)  # frozen by the compiler
    values = tuple((type(each), each) if isinstance(each, (bool, int, float, str)) else id(each) for each in named)
    key = (function.__code__, function.__defaults__, inside, id(function.__globals__), values)
    try:
        return _jitted.setdefault(key, (compiled(function), named))[0]  # what is kept cannot leave its id to others
    except TypeError:  # something inside is not hashable
        return compiled(function)


def kept(loop: Callable[..., Any], form: Form, arguments: tuple[Any, ...]) -> Any:
    """`loop`, compiled for arguments of one form: read from disk if an earlier process has compiled it, else left there.

    Numba keeps an index of all forms of a function, which processes that compile at the same time spoil for each other, and
    does not see changes of functions in other files. So each form is a function of its own, whose name tells form and code.
    """
    name = "_".join([loop.__name__, *(str(part) for part in form), SOURCES[:12]])
    own = types.FunctionType(loop.__code__, loop.__globals__, name)
    own.__module__, own.__qualname__ = loop.__module__, name
    try:
        loaded = numba.njit(cache=True, **OPTIONS)(own)
        loaded.compile(tuple(numba.typeof(argument) for argument in arguments))
    except Exception:  # no folder that may be written to, a full disk, a damaged file: without the disk, then
        return compiled(own)
    return loaded


@functools.cache
def _pool(n_threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(n_threads, thread_name_prefix="torchds")


if hasattr(os, "register_at_fork"):  # a forked process has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


_kernels: dict[tuple[Callable[..., Any], Form], Any] = {}
_steps: Counter[tuple[Callable[..., Any], Form, tuple[int, ...]]] = Counter()


def run(loop: Any, form: Form, sizes: tuple[int, ...], n: int, n_steps: int, n_threads: int, *arguments: Any) -> None:
    """Call `loop(first, last, *sizes, *arguments)` for all of `n` roll-outs, in several threads where that pays.

    A size reaches the loop as something that is as long. At first this is an array, and the loop one for all sizes. After
    `MANY` steps with the same sizes it is a tuple, whose length is known when the loop is compiled: that takes a second, and
    halves the time of a step. It is the same arithmetic in the same order, down to the last bit.

    Args:
        loop: a function of a module, or what numba has compiled already.
        form: what the types of the arguments depend on.
        sizes: lengths that the loop runs over in every step.
        n: roll-outs.
        n_steps: T.
        n_threads: at most.
        *arguments: the others.
    """
    own = hasattr(loop, "py_func")
    _steps[loop, form, sizes] += n * n_steps
    if often := not own and _steps[loop, form, sizes] > MANY:
        form += sizes
    arguments = (*((0,) * size if often else np.empty(size) for size in sizes), *arguments)
    kernel = _kernels.get((loop, form))
    if kernel is None:
        kernel = _kernels[loop, form] = loop if own else kept(loop, form, (0, n, *arguments))
    n_threads = min(n_threads, n)
    if n_threads < 2 or n * n_steps < MANY:
        kernel(0, n, *arguments)
        return
    edges = [n * j // n_threads for j in range(n_threads + 1)]
    calls = [_pool(n_threads).submit(kernel, *edges[j : j + 2], *arguments) for j in range(n_threads)]
    for call in calls:
        call.result()
