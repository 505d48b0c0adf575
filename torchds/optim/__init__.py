"""Policy search behind the interface of `torch.optim`.

Stability: stable.
"""

from torchds.optim import functional as functional
from torchds.optim.base import PolicySearch as PolicySearch
from torchds.optim.base import Update as Update
from torchds.optim.pi2 import PI2 as PI2
from torchds.optim.pi2cma import PI2CMA as PI2CMA
from torchds.optim.pibb import PIBB as PIBB
from torchds.optim.repeats import repeated as repeated
from torchds.optim.schedules import ExponentialDecay as ExponentialDecay
from torchds.optim.schedules import InverseIteration as InverseIteration
from torchds.optim.schedules import LinearDecay as LinearDecay
from torchds.optim.sharded import sharded as sharded
from torchds.optim.surrogate import SurrogatePIBB as SurrogatePIBB

__all__ = [
    "PI2",
    "PI2CMA",
    "PIBB",
    "ExponentialDecay",
    "InverseIteration",
    "LinearDecay",
    "PolicySearch",
    "SurrogatePIBB",
    "Update",
    "functional",
    "repeated",
    "sharded",
]
