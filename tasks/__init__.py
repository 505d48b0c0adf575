"""Tasks: what to learn, behind one small interface, found by name or by the place where they stand."""

from __future__ import annotations

from tasks.base import Task as Task
from tasks.constrained_reaching import ConstrainedReaching as ConstrainedReaching
from tasks.force_fields.divergent import DivergentField as DivergentField
from tasks.force_fields.half_plane import HalfPlaneForce as HalfPlaneForce
from tasks.registry import TASKS as TASKS
from tasks.registry import make as make
from tasks.registry import options_of as options_of
from tasks.registry import register as register
from tasks.registry import task_class as task_class
from tasks.released.constrained_reaching import ReleasedConstrainedReaching
from tasks.released.force_fields import ReleasedDivergentField, ReleasedHalfPlaneForce
from tasks.released.two_starts import ReleasedTwoStarts
from tasks.released.via_point import ReleasedViaPoint
from tasks.settings import Motion as Motion
from tasks.settings import Scene as Scene
from tasks.settings import SearchSettings as SearchSettings
from tasks.two_starts import TwoStarts as TwoStarts
from tasks.via_point import ViaPoint as ViaPoint

for _paper, _released in (
    (ViaPoint, ReleasedViaPoint),
    (TwoStarts, ReleasedTwoStarts),
    (DivergentField, ReleasedDivergentField),
    (HalfPlaneForce, ReleasedHalfPlaneForce),
    (ConstrainedReaching, ReleasedConstrainedReaching),
):
    register(_paper)
    register(_released)

PROBLEMS: dict[str, tuple[str, dict[str, str]]] = {
    "via_point-N": ("via_point", {"shape": "N"}),
    "via_point-P": ("via_point", {"shape": "P"}),
    **{name: (name, {}) for name in TASKS if name != "via_point"},
}
"""What can be learned and compared, by name: the task, and options of `make`."""

ENVIRONMENTS = {
    "".join(word[:1].upper() + word[1:] for word in name.replace("-", "_").split("_")): problem
    for name, problem in PROBLEMS.items()
    if name != "lwr_digging"  # it has an environment of its own, `tasks.digging.gym`
}
"""The problems as Gymnasium environments (`tasks.gym`): via_point-N is ViaPointN."""

__all__ = [
    "ENVIRONMENTS",
    "PROBLEMS",
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
    "options_of",
    "register",
    "task_class",
]
