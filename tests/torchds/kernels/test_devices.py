"""The device chooses the kernel."""

import sys
from types import SimpleNamespace

import pytest
import torch

from torchds import kernels
from torchds.kernels import Setting, Unfit


def test_on_a_gpu_triton_makes_the_rollouts_without_gradients(monkeypatch):
    made = SimpleNamespace(run=lambda field, start, setting: ("made", start))
    monkeypatch.setattr(kernels, "cuda", made, raising=False)
    monkeypatch.setitem(sys.modules, "torchds.kernels.cuda", made)
    field = SimpleNamespace(rows=SimpleNamespace(is_cuda=True, requires_grad=True))
    setting, x0 = Setting((), 3, 0.1), torch.zeros(2)
    with pytest.raises(Unfit, match="gradients on a GPU need the eager loop"):
        kernels.roll_out(field, x0, setting, None)
    with torch.no_grad():
        made, start = kernels.roll_out(field, x0, setting, None)
    assert made == "made" and start is x0
