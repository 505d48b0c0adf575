"""Checks for objects of your own, one for each kind that docs/extending.md shows; call them from your tests.

Each raises AssertionError with a sentence about what is not kept.

Stability: stable.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from torchds.errors import AllRolloutsFailedError
from torchds.exploration.base import Exploration
from torchds.optim.base import PolicySearch
from torchds.plants import Command, Plant
from torchds.rollouts import Rollout, rollout
from torchds.stops import StopCondition

N = 4  # roll-outs in the checks


def check_policy(policy: Any, x: Tensor) -> None:
    """Rows and parameters stand for each other, a batch gives what a loop gives, and a roll-out has gradients.

    Args:
        policy: one policy, without a batch.
        x: `(S, D)` points in its domain.
    """
    rows, features = policy.rows().detach(), policy.features(x)
    for name, value in policy.from_rows(rows).items():
        _same(value, policy.row_parameters[name], f"from_rows(rows()) has to be the parameter {name!r}")
    _same(policy.outputs(features, rows), features @ rows.mT, "outputs have to be rows times features")
    gating = policy.feature_gating(features)
    _holds(gating.shape == features.shape, "feature_gating needs one value per feature")
    _holds(bool(((gating >= 0) & (gating <= 1)).all()), "feature_gating has to be within [0, 1]")
    many = rows + 0.1 * _normals(N, *rows.shape).to(rows)
    batch = policy.outputs(policy.features(x.expand(N, *x.shape)), many)
    for one, some in zip(batch, many, strict=True):
        _same(one, policy.outputs(features, some), "a batch of rows has to give what each gives alone")
    torch.autograd.backward(rollout(policy, x, n_steps=3, dt=0.01).x.sum())
    for name, p in policy.row_parameters.items():
        _holds(
            p.grad is not None and bool(p.grad.isfinite().all()), f"{name!r} has no finite gradient along a roll-out"
        )
        p.grad = None
    single = copy.deepcopy(policy).float()
    _holds(single.features(x.float()).dtype == torch.float32, "features have to follow the dtype of x")


def check_exploration(exploration: Exploration, parameters: Sequence[nn.Parameter]) -> None:
    """Noise fits the parameters, belongs to its roll-out alone, is zero for zero normals, and comes back from a checkpoint.

    Args:
        exploration: to check.
        parameters: that it can perturb.
    """
    exploration.check(parameters)
    before = [p.detach().clone() for p in parameters]
    normals = [_normals(N, *p.shape).to(p) for p in parameters]
    noise = exploration(parameters, normals)
    for p, z, epsilon, old in zip(parameters, normals, noise, before, strict=True):
        _holds(epsilon.shape == z.shape and epsilon.dtype == p.dtype, f"noise has to be {tuple(z.shape)} of {p.dtype}")
        _same(p, old, "an exploration must not change the parameters")
    for zero in exploration(parameters, [torch.zeros_like(z) for z in normals]):
        _same(zero, torch.zeros_like(zero), "zero normals have to be zero noise")
    alone = [exploration(parameters, [z[i : i + 1] for z in normals]) for i in range(N)]
    again, theirs = copy.deepcopy((exploration, list(parameters)))
    again.load_state_dict(exploration.state_dict())
    for j, epsilon in enumerate(noise):
        _same(epsilon, torch.cat([one[j] for one in alone]), "the noise of a roll-out must not depend on the others")
        _same(epsilon, again(theirs, normals)[j], "state_dict has to hold all that the noise depends on")


def check_optimizer(make: Callable[[list[nn.Parameter]], PolicySearch]) -> None:
    """It learns, resumes bit for bit from state_dict, and does without roll-outs that fail.

    Args:
        make: builds the optimizer of one parameter `(2,)`, with an exploration of about 0.3 and 4 or more roll-outs.
    """
    target = torch.tensor([1.0, -1.0], dtype=torch.float64)
    theta = nn.Parameter(torch.zeros(2, dtype=torch.float64))
    optim = make([theta])

    def closure(p: nn.Parameter = theta) -> Tensor:
        return (p - target).square().sum(-1)

    for _ in range(20):
        optim.step(closure)
    left = float(closure().detach())
    _holds(left < 1.0, f"20 updates have to more than halve a quadratic cost of 2, got {left:.3g}")
    twin = nn.Parameter(theta.detach().clone())
    other = make([twin])
    other.load_state_dict(optim.state_dict())
    for _ in range(3):
        optim.step(closure)
        other.step(lambda: closure(twin))
    _holds(torch.equal(theta, twin), "an optimizer has to continue bit for bit from its state_dict")

    def first_fails() -> Tensor:
        return torch.cat([closure()[:1] * torch.nan, closure()[1:]])

    optim.step(first_fails)
    _holds(bool(theta.isfinite().all()), "a cost of NaN has to count for nothing")
    before = theta.detach().clone()
    try:
        optim.step(lambda: closure() * torch.nan)
        _holds(False, "costs of which none is finite have to raise AllRolloutsFailedError")
    except AllRolloutsFailedError:
        _same(theta, before, "where all roll-outs fail, the parameters stay")


def check_plant(plant: Plant, x0: Tensor) -> None:
    """It starts where it is told, a batch gives what a loop gives, and float32 stays float32.

    Args:
        plant: to check, for commands without stiffness.
        x0: `(S, D)` starts.
    """

    def run(x: Tensor) -> Tensor:
        state, v, path = plant.reset(x), torch.ones_like(x), []
        _same(state.x, x, "reset(x0) has to be at x0")
        for i in range(4):
            state = plant.step(state, Command(x, x + 0.1 * v, v, v, None, 0.1 * i, 0.1))
            x = x + 0.1 * v
            path.append(torch.cat([state.x, state.v], -1))
        return torch.stack(path, -2)

    many = run(x0.expand(N, *x0.shape))
    for i, start in enumerate(x0):
        _same(many[0, i], run(start), "a batch has to move as each does alone")
    _holds(run(x0.float()).dtype == torch.float32, "states have to follow the dtype of x0")


def check_stop(stop: StopCondition, x: Tensor) -> None:
    """One truth value per point, each its own; steps that are not finite are not taken.

    Args:
        stop: to check.
        x: `(S, D)` positions.
    """
    stopped = stop(x, x.flip(0))
    _holds(stopped.dtype == torch.bool and stopped.shape == x.shape[:-1], "stop has to return bool, one per point")
    for i, value in enumerate(stopped):
        _holds(bool(stop(x[i], x.flip(0)[i]) == value), "a point has to be judged by itself")
    _holds(bool(stop(x, torch.full_like(x, torch.nan)).all()), "a step to NaN must not be taken")


def check_cost(cost: Callable[[Rollout], Tensor], path: Rollout) -> None:
    """One cost per roll-out, each its own.

    Args:
        cost: to check.
        path: of a batch of policies from one start, `x` `(N, T+1, D)`.
    """
    costs = cost(path)
    _holds(costs.shape == path.x.shape[:1], f"{len(path.x)} roll-outs need as many costs, got {tuple(costs.shape)}")
    for i, value in enumerate(costs):
        parts: dict[str, Any] = {f.name: getattr(path, f.name) for f in dataclasses.fields(path)}
        parts = {name: part[i] if isinstance(part, Tensor) else part for name, part in parts.items()}
        _same(value, cost(Rollout(**parts)), "the cost of a roll-out must not depend on the others")


def _normals(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def _holds(condition: bool, sentence: str) -> None:
    if not condition:
        raise AssertionError(sentence)


def _same(actual: Tensor, expected: Tensor, sentence: str) -> None:
    torch.testing.assert_close(actual, expected, rtol=1e-9, atol=1e-12, msg=lambda found: f"{sentence}\n{found}")
