"""Fused roll-outs: one loop over time in compiled code, where this machine has it.

The eager loop of `torchds.rollout`, one tensor call a time step, is the definition; a kernel, made by numba for the CPU and by
Triton for a GPU, makes the same numbers but for round-off, and is tested against it. `backend="auto"` takes a kernel where one
exists and fits, and the eager loop otherwise; "eager" and "fused" ask for one of them. The environment variable
TORCHDS_BACKEND=eager makes "auto" mean "eager" everywhere.

Stability: stable.
"""

from __future__ import annotations

from torchds.kernels.choice import Backend as Backend
from torchds.kernels.choice import Unfit as Unfit
from torchds.kernels.choice import available as available
from torchds.kernels.choice import cannot as cannot
from torchds.kernels.choice import wanted as wanted
from torchds.kernels.devices import roll_out as roll_out
from torchds.kernels.fitting import check as check
from torchds.kernels.fitting import fits as fits
from torchds.kernels.fitting import flat_state as flat_state
from torchds.kernels.fitting import fusable as fusable
from torchds.kernels.fitting import scalar_step as scalar_step
from torchds.kernels.fused import Field as Field
from torchds.kernels.fused import Setting as Setting
from torchds.kernels.fused import control_cost as control_cost
from torchds.kernels.fused import sensitivity as sensitivity
from torchds.kernels.fused import stiffness_sensitivity as stiffness_sensitivity
from torchds.kernels.steps import ScalarStep as ScalarStep
from torchds.kernels.steps import own as own
