"""Section 5: motion and stiffness learned together in two force fields, and the controller (Figs 9 to 14)."""

from __future__ import annotations

import torch
from torch import Tensor

import tasks
from tasks import DivergentField
from torchds.impedance import ImpedanceControlled
from torchds.plants import Command
from torchds.rollouts import Rollout
from train.learning.learner import Learner
from train.paper.measured.base import learned

STEPS = 600  # after a step of the reference
SETTLED = 0.02  # of that step; nearer to its end a plant has settled
CRITICAL = 5.8339  # √(s/m) t at which critical damping is so near, (1 + z) e^−z = SETTLED


def divergent(runs: int, seed: int, **options: object) -> Learner:
    """The first experiment, learned."""
    return learned("divergent_field", runs, seed, **options)


def half_plane(runs: int, seed: int, stiffness: str = "diagonal") -> Learner:
    """The second experiment, learned."""
    return learned("half_plane_force", runs, seed, stiffness=stiffness)


def before_learning(name: str) -> tuple[tasks.Task, Rollout]:
    """A force-field task, and the motion of its policy before learning."""
    task = tasks.make(name)
    with torch.no_grad():
        return task, task.rollout(task.policy())


def final(learner: Learner) -> Rollout:
    """The noise-free roll-out of the learned policies."""
    assert learner.path is not None
    return learner.path


def via_points(task: tasks.Task) -> Tensor:
    """The one set of via-points `(L, D)`."""
    (found,) = task.scene().via_points.values()
    return found


def off_nominal(task: DivergentField, x: Tensor) -> Tensor:
    """Distance `(T,)` of the points of a motion `(T+1, 2)` from the nominal path, where the field has no force [m]."""
    return (x[1:, None] - task.nominal()).norm(dim=-1).amin(-1)


def pushed(path: Rollout) -> Tensor:
    """Largest distance `(*batch)` between the executions with and without the force, at one time [m]."""
    return (path.x[..., 1, :, :] - path.x[..., 0, :, :]).norm(dim=-1).amax(-1)


def stiffness_by_half(path: Rollout) -> tuple[Tensor, Tensor]:
    """Mean applied stiffness `(runs, D)` of each axis where the force can be, and elsewhere, over executions [N/m]."""
    s = path.plant.stiffness[..., 1:, :]
    there = (path.plant.x[..., 1:, :1] > -5).to(s)

    def mean(weight: Tensor) -> Tensor:
        return (s * weight).sum((1, 2)) / weight.sum((1, 2))

    return mean(there), mean(1 - there)


@torch.no_grad()
def step_response(plant: ImpedanceControlled, stiffness: Tensor, dt: float) -> Tensor:
    """Where the plant is after each time step `(STEPS, N, 1)` behind a unit step of the reference; infinite if nowhere."""
    one, zero = torch.ones_like(stiffness), torch.zeros_like(stiffness)
    state, x = plant.reset(zero), []
    for i in range(STEPS):
        state = plant.step(state, Command(one, one, zero, zero, stiffness, i * dt, dt))
        x.append(state.x.nan_to_num(nan=torch.inf))
    return torch.stack(x)


def overshoot(x: Tensor) -> Tensor:
    """How far a `step_response` runs over the unit step `(N, 1)`; infinite where it diverges."""
    return x.amax(0) - 1


def settling(x: Tensor, dt: float) -> Tensor:
    """When a `step_response` is farther than `SETTLED` from its end for the last time `(N, 1)` [s]."""
    after = dt * torch.arange(1, len(x) + 1, dtype=x.dtype)[:, None, None]
    return (after * ((x - 1).abs() > SETTLED)).amax(0)
