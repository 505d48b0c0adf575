"""Tasks: what to learn, behind one small interface, found by name."""

from __future__ import annotations

import inspect
from typing import Any

from tasks.base import Motion as Motion
from tasks.base import Scene as Scene
from tasks.base import SearchSettings as SearchSettings
from tasks.base import Task as Task
from tasks.constrained_reaching import ConstrainedReaching as ConstrainedReaching
from tasks.force_fields.divergent import DivergentField as DivergentField
from tasks.force_fields.half_plane import HalfPlaneForce as HalfPlaneForce
from tasks.two_starts import TwoStarts as TwoStarts
from tasks.via_point import ViaPoint as ViaPoint
from torchds.errors import InvalidArgumentError, UnknownNameError

TASKS: dict[str, type[Task]] = {
    "via_point": ViaPoint,
    "two_starts": TwoStarts,
    "divergent_field": DivergentField,
    "half_plane_force": HalfPlaneForce,
    "constrained_reaching": ConstrainedReaching,
}


NAMES = (*TASKS, "lwr_digging")
"""All tasks; the digging task needs its extra, and is imported when it is asked for."""


def task_class(name: str) -> type[Task]:
    """The class of the task `name`.

    Raises:
        UnknownNameError: no task of this name; the message lists them.
        MissingPackageError: the task needs an extra that is not installed.
    """
    if name not in NAMES:
        raise UnknownNameError("task", name, NAMES)
    if name == "lwr_digging":
        from tasks.digging.task import LwrDigging

        return LwrDigging
    return TASKS[name]


def make(name: str, **options: Any) -> Task:
    """Build the task `name` with its own options.

    Raises:
        UnknownNameError: no task of this name; the message lists them.
        MissingPackageError: the task needs an extra that is not installed.
        InvalidArgumentError: an option that the task does not have, or a value that it does not allow.
    """
    cls = task_class(name)
    allowed = inspect.signature(cls).parameters
    if strangers := sorted(set(options) - set(allowed)):
        raise InvalidArgumentError(f"task {name!r} has no option {', '.join(strangers)}; it has {', '.join(allowed)}")
    return cls(**options)


__all__ = [
    "NAMES",
    "TASKS",
    "ConstrainedReaching",
    "DivergentField",
    "HalfPlaneForce",
    "Motion",
    "Scene",
    "SearchSettings",
    "Task",
    "TwoStarts",
    "ViaPoint",
    "make",
    "task_class",
]
