"""Runs without pictures, kept by their options: found where they were made, continued where they were interrupted."""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Callable
from typing import Any

import tasks
from train.folder import OPTIONS, RESULTS, RunFolder, check_identity
from train.learning.history import results
from train.learning.learner import Learner
from train.options import RunOptions

SAVE_EVERY = 10.0  # s between two checkpoints


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
    key = json.dumps([options.task, options.device, own])
    if key not in _made:
        _made.clear()
        task = options.make_task()
        _made[key] = task, copy.deepcopy(task.state_dict())
    task, state = _made[key]
    task.load_state_dict(state)
    return task
