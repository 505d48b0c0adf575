"""How long a policy takes in a control loop, in every form in which it leaves torch: `python -m train latency`."""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchds import Controller, GMRPolicy, export
from train.benchmark.programs import printed
from train.folder import versions, write_text
from train.tables import markdown

SIZES = ((2, 4), (6, 10))
"""D and K."""
ROUNDS = 20


@dataclass
class Latency:
    """Time one evaluation of a policy in every form in which it can leave the computer, on one core."""

    ticks: int = 20_000
    """How often each is timed."""

    def main(self) -> None:
        """Print a table: median and 99th percentile for each form and size, in microseconds."""
        print(", ".join(f"{name} {value}" for name, value in versions().items()))
        header = ["form", *(f"D = {D}, K = {K}: {what} [µs]" for D, K in SIZES for what in ("median", "99 %"))]
        columns = [self.times(dict(forms(policy(D, K)))) for D, K in SIZES]
        rows = [[name, *(f"{value:.1f}" for column in columns for value in column[name])] for name in columns[0]]
        print(markdown(header, rows, "l" + "r" * (len(header) - 1)))

    def times(self, calls: dict[str, Callable[[], Any]]) -> dict[str, tuple[float, float]]:
        """Median and 99th percentile of each call [µs], in turn, so that none of them has the quiet minute alone."""
        seconds: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(ROUNDS):
            for name, call in calls.items():
                for _ in range(50):
                    call()
                for _ in range(max(1, self.ticks // ROUNDS)):
                    began = time.perf_counter()
                    call()
                    seconds[name].append(time.perf_counter() - began)
        both = {name: 1e6 * np.quantile(values, [0.5, 0.99]) for name, values in seconds.items()}
        return {name: (float(middle), float(high)) for name, (middle, high) in both.items()}


def policy(D: int, K: int) -> GMRPolicy:
    """A stable policy of D dimensions and K Gaussians."""
    draw = functools.partial(torch.randn, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    eye = torch.eye(D, dtype=torch.float64)
    return GMRPolicy(torch.ones(K) / K, draw(K, D), eye.repeat(K, 1, 1), 0.1 * draw(K, D, D) - eye, torch.zeros(K, D))


def forms(policy: GMRPolicy) -> Iterator[tuple[str, Callable[[], Any]]]:
    """The calls of one tick by their names; what is not installed is left out."""
    x = np.ones(policy.input_dim)
    bounds: dict[str, Any] = {"max_speed": 1.0, "max_acceleration": 5.0, "workspace": (-9.0, 9.0)}
    for name, compiled in (("numpy", False), ("compiled", True)):
        if compiled and importlib.util.find_spec("numba") is None:
            continue
        for what, options in (("", {}), (", within bounds", bounds)):
            controller = Controller(policy, 1e-3, compiled=compiled, **options)
            controller.reset(x)
            yield f"`Controller`, {name}{what}", controller.step
        controller = Controller(policy, 1e-3, feedback=True, compiled=compiled)
        controller.reset(x)
        yield f"`Controller`, {name}, feedback", functools.partial(controller.step, x)
    with tempfile.TemporaryDirectory() as folder:
        yield from exported(policy, Path(folder))
    state = torch.ones(policy.input_dim, dtype=torch.float64)
    yield "`policy(x)`, torch without gradients", torch.no_grad()(functools.partial(policy, state))


def exported(policy: GMRPolicy, folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """The programs that `torchds.export` writes, at one state and called from Python."""
    x = np.ones(policy.input_dim)
    if shutil.which("gcc"):
        export(policy, folder / "motion.h", format="c")
        write_text(
            folder / "motion.c",
            '#include "motion.h"\nvoid evaluate(const double *x, double *y) { motion_evaluate(x, y); }\n',
        )
        build = ["gcc", "-O2", "-shared", "-fPIC", "motion.c", "-o", "motion.so", "-lm"]
        printed(build, cwd=folder)
        y = np.empty(policy.output_dim + policy.stiffness_dim)
        pointers = [array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in (x, y)]
        evaluate = ctypes.CDLL(str(folder / "motion.so")).evaluate
        yield '`export(format="c")`, through ctypes', lambda: (evaluate(*pointers), y)[1:]
    if all(importlib.util.find_spec(package) for package in ("onnxscript", "onnxruntime")):
        import onnxruntime

        export(policy, folder / "policy.onnx")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(str(folder / "policy.onnx"), options)
        given = {session.get_inputs()[0].name: x[None]}
        yield '`export(format="onnx")`, ONNX Runtime', lambda: session.run(None, given)
    if shutil.which("g++"):
        export(policy, folder / "policy.pt2", format="aoti")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of torch about itself
            package = torch._inductor.aoti_load_package(str(folder / "policy.pt2"))
        state = torch.from_numpy(x)[None]
        yield '`export(format="aoti")`, AOTInductor', torch.no_grad()(lambda: package(state))
