"""The kernels for GPUs without a GPU: Triton's interpreter runs them on tensors of the CPU."""

import importlib
import sys
from contextlib import contextmanager

import pytest

from torchds import kernels
from torchds.kernels import fused

pytest.importorskip("triton", minversion="3.7")  # the interpreter of earlier ones fails beside numpy 2.4
PARTS = ("cuda_steps", "cuda_loop", "cuda")


@contextmanager
def loaded(interpreted):
    """`torchds.kernels.cuda`, loaded anew, and taken for tensors of the CPU as well; as it was before, afterwards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRITON_INTERPRET", str(int(interpreted)))
        for name in PARTS:
            patch.setattr(kernels, name, None, raising=False)
            patch.setitem(sys.modules, f"torchds.kernels.{name}", None)
            del sys.modules[f"torchds.kernels.{name}"]
        cuda = importlib.import_module("torchds.kernels.cuda")
        assert (type(cuda.roll).__name__ == "InterpretedFunction") == interpreted
        patch.setattr(fused, "_run", cuda.run)
        yield cuda


@pytest.fixture(scope="module", autouse=True)
def interpreter():
    with loaded(interpreted=True) as cuda:
        yield cuda
