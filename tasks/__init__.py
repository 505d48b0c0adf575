"""Tasks: what to learn, behind one small interface, found by name."""

from __future__ import annotations

import inspect
from typing import Any

from tasks.base import Scene as Scene
from tasks.base import SearchSettings as SearchSettings
from tasks.base import Task as Task
from tasks.constrained_reaching import ConstrainedReaching as ConstrainedReaching
from tasks.divergent_field import DivergentField as DivergentField
from tasks.half_plane_force import HalfPlaneForce as HalfPlaneForce
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


def make(name: str, **options: Any) -> Task:
    """Build the task `name` with its own options.

    Raises:
        UnknownNameError: no task of this name; the message lists them.
        InvalidArgumentError: an option that the task does not have, or a value that it does not allow.
    """
    if name not in TASKS:
        raise UnknownNameError("task", name, TASKS)
    allowed = inspect.signature(TASKS[name]).parameters
    if strangers := sorted(set(options) - set(allowed)):
        raise InvalidArgumentError(f"task {name!r} has no option {', '.join(strangers)}; it has {', '.join(allowed)}")
    return TASKS[name](**options)


__all__ = [
    "TASKS",
    "ConstrainedReaching",
    "DivergentField",
    "HalfPlaneForce",
    "Scene",
    "SearchSettings",
    "Task",
    "TwoStarts",
    "ViaPoint",
    "make",
]
