"""The state of the page in its folder: the problem, and the folders of its learning runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from tasks.sketch import Problem
from torchds.errors import TorchdsError
from torchds.files import write_text
from train.view.studio.side import check_learners

STATE, UNREAD = "state.json", "state.unread.json"


def write(folder: Path, problem: Problem, runs: Sequence[Path | None]) -> None:
    """Keep it, whole or not at all.

    Raises:
        FileError: it cannot be written.
    """
    said = {"problem": problem.to_json(), "runs": [None if run is None else str(run.resolve()) for run in runs]}
    write_text(folder / STATE, json.dumps(said))


def read(folder: Path) -> tuple[Problem, list[Path | None]] | None:
    """What was kept; None where nothing was, or nothing that can be read, which is then put aside."""
    path = folder / STATE
    if not path.is_file():
        return None
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        problem = Problem.from_json(said["problem"])
        check_learners(problem)
        return problem, [None if run is None else Path(run) for run in said["runs"]]
    except (OSError, ValueError, KeyError, TypeError, TorchdsError):
        path.replace(folder / UNREAD)
        print(f"note: {path} could not be read; it is {folder / UNREAD} now", file=sys.stderr)
        return None
