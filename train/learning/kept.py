"""Runs without pictures, kept by their options: found where they were made, continued where they were interrupted."""

from __future__ import annotations

import copy
import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tasks
from tasks.loading import file_of, helpers
from train.folder import OPTIONS, RESULTS, RunFolder, check_identity
from train.learning.history import results
from train.learning.learner import Learner
from train.options import RunOptions, usual_values

SAVE_EVERY = 10.0  # s between two checkpoints


def key(options: RunOptions) -> str:
    """Which run these options are, as part of the name of its folder.

    Options that are as usual are left out: one that is added to the project later changes no keys. Files that are named count
    by their content, with what they import from beside them: one that was edited is another run, and one that is mounted
    elsewhere the same.
    """
    usual = usual_values(options)
    own = {
        name: known_by(getattr(options, name), value)
        for name, value in options.to_json().items()
        if value != usual.get(name) and name != "logdir"
    }
    said = json.dumps([known_by(options.task, options.task), own], sort_keys=True)
    return hashlib.sha256(said.encode()).hexdigest()[:16]


def known_by(value: Any, said: Any) -> Any:
    """The path of a file with its content, the place of a class or a problem by name and content; others as they are said."""
    path = value if isinstance(value, Path) else file_of(value) if isinstance(value, str) else None
    if path is None or not path.exists():
        return said
    files = sorted(path.glob("*")) if path.is_dir() else [path, *(helpers(path) if path.suffix == ".py" else [])]
    name = said if isinstance(value, Path) else Path(said).name
    return [name, *(hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.is_file())]


def found(folder: RunFolder, options: RunOptions) -> dict[str, Any] | None:
    """Results that are there, if they are those of these options; None if there are none.

    Raises:
        FileError: they are damaged, or of others.
    """
    if not folder.has(RESULTS):
        return None
    record = folder.results()
    check_identity(folder.path / RESULTS, record, options)
    return record


def learned(folder: RunFolder, learner: Learner, watch: Callable[[Learner], None]) -> dict[str, Any]:
    """The results of a run: those in the folder, or new ones, continued from its checkpoint.

    Args:
        folder: which nobody else writes to.
        learner: new, with the options of the run.
        watch: called after each update, before anything is written; what it raises stops the run.

    Raises:
        FileError: what is there is damaged or of other options, or nothing can be written.
    """
    options = learner.options
    if (record := found(folder, options)) is not None:  # somebody else has just made it
        return record
    if not folder.has(OPTIONS):
        folder.begin(options.task, options.to_json())
    folder.restore(learner)
    learner.start()
    saved = time.monotonic()
    while learner.done < learner.n_updates:
        learner.update()
        watch(learner)
        if time.monotonic() - saved > SAVE_EVERY:
            folder.save_checkpoint(learner)
            saved = time.monotonic()
    folder.write_results(results(options.task, options.to_json(), learner.history))
    folder.drop_checkpoint()
    return folder.results()


_made: dict[str, tuple[tasks.Task, dict[str, Any]]] = {}


def made(options: RunOptions) -> tasks.Task:
    """The task of these options as if new, fitted once for all runs that follow each other."""
    own = {name: str(value) for name, value in options.task_options().items()}
    said = json.dumps([known_by(options.task, options.task), options.device, own])
    if said not in _made:
        _made.clear()
        task = options.make_task()
        _made[said] = task, copy.deepcopy(task.state_dict())
    task, state = _made[said]
    task.load_state_dict(state)
    return task
