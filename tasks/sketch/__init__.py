"""Problems that were drawn: a motion in the plane and what is asked of it, as one JSON file that is a task."""

from __future__ import annotations

from pathlib import Path

from tasks.sketch.problem import Problem as Problem
from tasks.sketch.task import Sketch as Sketch


def examples() -> dict[str, Path]:
    """The problem files that come with the project, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "examples").glob("*.json"))}


__all__ = ["Problem", "Sketch", "examples"]
