"""Policy search behind the interface of `torch.optim`."""

from torchds.optim import functional as functional
from torchds.optim.base import PolicySearch as PolicySearch
from torchds.optim.base import Update as Update
from torchds.optim.pibb import PIBB as PIBB
from torchds.optim.schedules import InverseIteration as InverseIteration

__all__ = ["PIBB", "InverseIteration", "PolicySearch", "Update", "functional"]
