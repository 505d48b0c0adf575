"""What a sweep consists of: a file in TOML whose lists are multiplied."""

from __future__ import annotations

import itertools
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from tasks.loading import short
from torchds.errors import FileError, InvalidArgumentError
from torchds.files import reason
from train.learning.kept import key
from train.learning.run import check
from train.options import UNKEPT, RunOptions, options_class

OF_THE_SWEEP = (*UNKEPT, "logdir")


class Job(NamedTuple):
    """One run of a sweep.

    Attributes:
        name: of its folder; it says by its options which one it is, whatever else is in the sweep.
        options: of the run.
    """

    name: str
    options: RunOptions


def read(path: Path) -> list[Job]:
    """The jobs of a file.

    Each key is an option of the training commands, `task` among them. A list multiplies the sweep by its entries; an entry that
    is a table says several options at once, under a key of any name. `seeds = 20` is `seed = [0, ..., 19]`.

    Raises:
        FileError: the file cannot be read, or is no TOML.
        InvalidArgumentError: a job without a task, an option said twice, or one that cannot be.
        UnknownNameError: a task, an optimizer, an exploration or an option that does not exist.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{path} is no readable file of a sweep in TOML: {reason(error)}") from error
    if "seeds" in content:
        seeds = content.pop("seeds")
        if "seed" in content or not isinstance(seeds, int) or seeds < 1:
            raise InvalidArgumentError(
                f"{path}: seeds has to be a number of seeds, without seed beside it, got {seeds!r}"
            )
        content["seed"] = list(range(seeds))
    axes = [
        [
            entry if isinstance(entry, dict) else {key: entry}
            for entry in (value if isinstance(value, list) else [value])
        ]
        for key, value in content.items()
    ]
    jobs = [_job(path, combination) for combination in itertools.product(*axes)]
    return list({job.name: job for job in jobs}.values())  # a job that is there twice is one


def _job(path: Path, parts: tuple[dict[str, Any], ...]) -> Job:
    values: dict[str, Any] = {}
    for part in parts:
        if twice := values.keys() & part.keys():
            raise InvalidArgumentError(
                f"{path}: {', '.join(sorted(twice))} is said twice for one job, by {values} and {part}"
            )
        values |= part
    task = values.pop("task", None)
    if not isinstance(task, str):
        raise InvalidArgumentError(
            f'{path}: each job needs a task, e.g. task = ["via_point", "two_starts"], got {task!r}'
        )
    if own := values.keys() & set(OF_THE_SWEEP):
        raise InvalidArgumentError(
            f"{path}: {', '.join(sorted(own))} belongs to the command, leave it out of the sweep"
        )
    try:
        options = options_class(task).from_json(values)
        check(options)
    except InvalidArgumentError as error:
        raise InvalidArgumentError(f"{path}: {error}") from error
    return Job(name(options), options)


def name(options: RunOptions) -> str:
    """Of a folder for these options."""
    return f"{options.name}-{short(options.optimizer)}-{key(options)}"
