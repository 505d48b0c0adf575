"""Motions that need no robot, a letter in the plane and poses in space, and the files that a robot would write."""

import copy
import functools

import numpy as np
import torch

import torchds
from tests.motions import Short
from torchds.sessions import Layout, Session, Trial

POSES = Layout(
    ("x [m]", "y [m]", "z [m]", "rx [rad]", "ry [rad]", "rz [rad]"),
    start=(0.01,) * 3 + (0.05,) * 3,
    lever=(1,) * 3 + (0.2,) * 3,
)


def letter():
    """Trial and policy of the via-point task, in a tenth of its steps."""
    task = Short()
    return Trial.of(task), task.policy()


def poses():
    """A motion of poses whose cost is how far its end is from a place."""
    t = torch.linspace(0, 1, 41, dtype=torch.float64)[:, None]
    s = 1 - t**3 * (10 - 15 * t + 6 * t**2)
    start = torch.tensor([-0.12, -0.2, 0.1, 0.4, -0.5, 0.6], dtype=torch.float64)
    demos = torchds.Demonstrations([s * start * share for share in (0.9, 1.0, 1.1)], dt=0.05)
    policy = torchds.GMRPolicy.from_demonstrations(demos, n_components=2)
    goal = torch.tensor([0.0, 0.02, 0.01, 0, 0, 0.1], dtype=torch.float64)

    def cost(path):
        return {"goal": (path.x[..., -1, :] - goal).square().sum(-1), "effort": 1e-3 * path.v.square().sum((-1, -2))}

    return Trial(start, 40, 0.05, POSES, cost), policy


MOTIONS = {"letter": letter, "poses": poses}


@functools.cache
def fitted(motion):
    return MOTIONS[motion]()


def made(motion):
    """Trial and policy, new ones of the same numbers each time."""
    trial, policy = fitted(motion)
    return copy.copy(trial), copy.deepcopy(policy)


def session(folder, motion="letter", n_rollouts=3, n_updates=2, seed=0):
    """A session as a script makes it each time that it is started."""
    trial, policy = made(motion)
    exploration = torchds.exploration.TrajectorySpace.relative(policy, trial.x0, trial.n_steps, trial.dt)
    generator = torch.Generator().manual_seed(seed)
    options = {"n_rollouts": n_rollouts, "elite": "nominal", "control_weight": 1e-4, "generator": generator}
    optim = torchds.optim.PIBB(policy.parameters(), exploration=exploration, **options)
    decay = torch.optim.lr_scheduler.LambdaLR(optim, torchds.optim.InverseIteration())
    return Session(folder, trial, policy, optim, n_updates=n_updates, schedulers=[decay])


def record(mine, k, change=lambda x: x, of=None):
    """Write what a robot made of a reference, exactly followed but for `change`."""
    folder, layout = mine.update_folder, mine.trial.layout
    table = np.loadtxt(folder / f"rollout-{of or k}.csv", delimiter=",", skiprows=1)
    n = len(layout.position)
    rows = np.column_stack([table[:, 0], change(table[:, 1 : n + 1])])
    header = ",".join(layout.recording)
    np.savetxt(folder / f"recording-{k}.csv", rows, "%.17g", ",", header=header, comments="")


def costs(mine, *values):
    lines = "".join(f"{k},{value}\n" for k, value in enumerate(values, 1))
    (mine.update_folder / "costs.csv").write_text(f"rollout,cost\n{lines}")


def learned(motion="letter"):
    """The optimizer of a session, in simulation: trial, policy, optimizer, decay."""
    trial, policy = made(motion)
    exploration = torchds.exploration.TrajectorySpace.relative(policy, trial.x0, trial.n_steps, trial.dt)
    options = {
        "n_rollouts": 3,
        "elite": "nominal",
        "control_weight": 1e-4,
        "generator": torch.Generator().manual_seed(0),
    }
    optim = torchds.optim.PIBB(policy.parameters(), exploration=exploration, **options)
    return trial, policy, optim, torch.optim.lr_scheduler.LambdaLR(optim, torchds.optim.InverseIteration())
