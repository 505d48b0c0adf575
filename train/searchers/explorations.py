"""Explorations by the names that the commands know."""

from __future__ import annotations

from typing import Any, cast

from tasks import Task
from tasks.loading import is_spec
from torchds import GMRPolicy
from torchds.dmp import DMP
from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration, Gaussian, Homogeneous, Stable, TrajectorySpace
from torchds.exploration.primitive import Along, alike
from train.options import RunOptions
from train.searchers.own import make_own


def along_motion(options: RunOptions) -> bool:
    """Whether the exploration is one along the motion."""
    return options.exploration in ("trajectory", "stable-trajectory")


def make_exploration(options: RunOptions, task: Task, policy: GMRPolicy) -> Exploration:
    """The exploration that `--exploration`, `--noise` and `--shrink` name; your own gets the policy, and the noise if given."""
    if is_spec(options.exploration):
        given = () if options.noise is None else (options.noise,)
        return make_own("exploration", options.exploration, Exploration, policy, *given)  # type: ignore[type-abstract]
    if isinstance(policy, DMP):
        return of_primitive(options, task, policy)
    search, learn = task.search, options.learn
    std = search.std if options.noise is None else options.noise
    if options.exploration == "gaussian":
        return Gaussian.relative(policy, *task.motion()) if std is None else Gaussian(std)
    goal = task.scene().goal
    if options.exploration == "stable":
        raw = Gaussian.relative(policy, *task.motion(), goal=goal) if std is None else Gaussian(std)
        return Stable(policy, raw, goal, task.P, shrink=options.shrink)
    own_speed, mean_stiffness = sizes(task, policy)
    if along_motion(options):
        if learn != "both":
            raise InvalidArgumentError(f"--learn {learn} goes with --exploration homogeneous, not trajectory")
        stable = options.exploration == "stable-trajectory"
        tied = goal if stable else None
        if search.spread is None:
            size: dict[str, Any] = {} if options.noise is None else {"spread": options.noise}
            along = TrajectorySpace.relative(policy, *task.motion(), **size, goal=tied)
        else:
            along = TrajectorySpace(
                policy,
                *task.motion(),
                spread=search.spread if options.noise is None else options.noise,
                stiffness_spread=search.stiffness_spread,
                mean_speed=own_speed,
                mean_stiffness=mean_stiffness,
                goal=tied,
            )
        return Stable(policy, along, goal, task.P, shrink=options.shrink) if stable else along
    mean_speed = own_speed if options.noise is None else options.noise
    return search.homogeneous(
        policy,
        0.0 if learn == "stiffness" else mean_speed,
        mean_stiffness=0.0 if learn == "motion" else mean_stiffness,
    )


def of_primitive(options: RunOptions, task: Task, policy: DMP) -> Exploration:
    """The noise of a dynamic movement primitive; `--noise` is a share of the motion's extent."""
    kinds = {"homogeneous": alike, "gaussian": alike, "trajectory": Along.relative}
    if options.exploration not in kinds:
        raise InvalidArgumentError(
            f"--exploration {options.exploration} needs a dynamical system; for a primitive use {' or '.join(kinds)}"
        )
    make: Any = kinds[options.exploration]
    return cast(Exploration, make(policy, *task.motion(), *(() if options.noise is None else (options.noise,))))


def sizes(task: Task, policy: GMRPolicy) -> tuple[float, float]:
    """`mean_speed` and `mean_stiffness` of a task's homogeneous exploration; shares of its motion where it gives none."""
    speed, stiffness = task.search.mean_speed, task.search.mean_stiffness
    if speed is not None and stiffness is not None:
        return speed, stiffness
    shares = Homogeneous.relative(policy, *task.motion())
    return shares.mean_speed if speed is None else speed, shares.mean_stiffness if stiffness is None else stiffness
