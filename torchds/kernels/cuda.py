"""Roll-outs on a GPU: tensors in and out of the loop that Triton compiles.

A table has a row for each number and a column for each roll-out, policy or gating, so that what the 32 roll-outs of a program
read or write at once lies side by side. Products are rounded before they are added, as on the CPU, so that the numbers are
the same in whatever company.

Stability: experimental.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchds.kernels.choice import Unfit
from torchds.kernels.cuda_loop import roll
from torchds.kernels.fused import Field, Setting, Track, recurring
from torchds.kernels.steps import NONE, ScalarStep

TOGETHER = 32  # roll-outs of a program, which is one warp
OLDEST = (7, 0)  # compute capability that Triton still compiles for
LARGEST = 1000  # K (D+1) (D+O+Q): Triton compiles for half a minute, since each product of a step is code of its own


def run(field: Field, start: Tensor, setting: Setting) -> Track:
    """A roll-out on a GPU.

    Args:
        field: the policy.
        start: `(*points, D)` or `(*batch, *points, D)`.
        setting: all else.

    Raises:
        Unfit: a stop condition, a force or a plant with a step in Python; a policy whose code would be too long.
    """
    lead, T, rows, O = setting.lead, setting.n_steps, field.rows, field.n_velocities
    n, K, D, Q = math.prod(lead), *field.factors.shape[-3:-1], rows.shape[-2] - O
    steps = setting.stop, setting.plant, setting.plant and setting.plant.force
    stops, _, pushes = map(_kind, steps)
    if (size := K * (D + 1) * (D + O + Q)) > LARGEST:
        raise Unfit(f"a policy of this size has too long a kernel, K (D+1) (D+O+Q) is {size} and at most {LARGEST}")
    gates = torch.cat([field.center, field.factors.flatten(-3), field.offset, field.log_scale], -1)
    begin = None if setting.begin is None else setting.begin.expand(*lead, 5 * D)
    sizes = [D, 0 if begin is None else 5 * D, O, K, Q]
    path = rows.new_empty(T + 1, sum(sizes), n)
    resting = None if setting.stop is None else rows.new_empty(T, n, dtype=torch.bool)
    given = setting.shift, *(step and step.parameters for step in steps)
    shift, stop, plant, force = (_table(None if t is None else recurring(t, lead)) for t in given)
    with torch.cuda.device(rows.get_device()):  # -1 for the CPU, of which nothing is chosen
        roll[(-(-n // TOGETHER),)](
            n, T, n // math.prod(rows.shape[:-2]), setting.dt, rows.detach().contiguous(), *_table(gates)[:2],
            *_table(start)[:2], *shift[:2], _table(begin)[0], path, resting, *stop, *plant, *force,
            STOP=stops, FORCE=pushes, CHANCE=plant[2] > 7 + D, K=K, D=D, O=O, Q=Q, LIMIT=field.limit, TOGETHER=TOGETHER,
            num_warps=1, enable_fp_fusion=False,
        )  # fmt: skip
    written = path.permute(2, 0, 1).reshape(*lead, T + 1, -1)
    x, states, v, gating, stiffness = torch.split(written, sizes, -1)
    track = Track(x, v[..., :-1, :], gating[..., :-1, :], stiffness[..., :-1, :])
    if resting is not None:
        track = track._replace(resting=resting.T.reshape(*lead, T))
    return track if begin is None else track._replace(states=states)


def ready() -> None:
    """Raise a RuntimeError where Triton cannot start kernels: it needs a GPU that it compiles for, and a C compiler."""
    import triton

    triton.runtime.driver.active.get_current_device()
    if torch.version.hip is None and torch.cuda.get_device_capability() < OLDEST:
        raise RuntimeError(f"Triton needs a GPU of compute capability {OLDEST}")


def _kind(step: ScalarStep | None) -> int:
    """Which of the steps that compiled code knows."""
    if step is None:
        return NONE
    if callable(step.function):
        raise Unfit("a scalar step in Python is for the CPU")
    return step.function


def _table(values: Tensor | None) -> tuple[Tensor | None, int, int]:
    """Numbers `(*lead, m)` as the columns of a table, with how many columns and rows it has; no numbers, no table."""
    if values is None:
        return None, 0, 0
    table = values.detach().reshape(-1, values.shape[-1]).T.contiguous()
    return table, table.shape[1], table.shape[0]
