"""The folder of a run: which files it has, and writes that a kill cannot leave half done."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import torch

from torchds.errors import InvalidArgumentError
from train.options import RunOptions, options_class

OPTIONS, CHECKPOINT, RESULTS, POLICY = "options.json", "checkpoint.pt", "results.json", "policy.pt"


class Interrupted(Exception):
    """The run was stopped from the keyboard; its folder can be resumed."""


class Resumable(Protocol):
    """What a checkpoint is loaded into."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where the state was taken."""


class RunFolder:
    """What a run leaves behind, and what it resumes from.

    `options.json` holds `{"task", "options"}` and is there from the beginning, `checkpoint.pt` what the learner needs to
    continue, `results.json` what `train.learning.history.results` says, and `policy.pt` the policies; the last two are
    there in the end. Readers see an old file or a new one, never a half.

    Args:
        path: of the folder, which need not be there.
        option: of the command that named it, for messages.
    """

    def __init__(self, path: Path, option: str = "") -> None:
        self.path, self.option = path, option

    @classmethod
    def new(cls, logdir: Path, task: str, optimizer: str, seed: int) -> RunFolder:
        """Make LOGDIR/<task>/<optimizer>/<time>-<seed>/, a new one in any case."""
        parent = logdir / task / optimizer
        stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{seed}"
        names = (stem if i == 0 else f"{stem}.{i}" for i in range(1000))
        for path in (parent / name for name in names):
            try:
                path.mkdir(parents=True)
            except FileExistsError:
                continue
            return cls(path)
        raise InvalidArgumentError(f"cannot make a new folder like {parent / stem}")

    def has(self, name: str) -> bool:
        """Whether a file is there."""
        return (self.path / name).is_file()

    def require(self, *names: str) -> None:
        """Refuse a folder that lacks one of the files.

        Raises:
            InvalidArgumentError: which ones are missing.
        """
        if missing := [name for name in names if not self.has(name)]:
            kind = "run" if names == (OPTIONS,) else "finished run"
            raise InvalidArgumentError(
                f"{self.option} {self.path}: no {', '.join(missing)} there; give the folder of a {kind}, below logs/".strip()
            )

    def begin(self, task: str, options: dict[str, Any]) -> None:
        """Make the folder where it is missing, and write down what is to be run."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_json(self.path / OPTIONS, {"task": task, "options": options})

    def options(self) -> RunOptions:
        """Those that it was begun with.

        Raises:
            InvalidArgumentError: no run is there.
        """
        self.require(OPTIONS)
        content = json.loads((self.path / OPTIONS).read_text())
        return options_class(content["task"]).from_json(content["options"])

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Keep the state of a learner."""
        save_state(self.path / CHECKPOINT, state)

    def restore(self, learner: Resumable) -> None:
        """Bring a learner to the last checkpoint; where there is none yet, it stays as it is."""
        if self.has(CHECKPOINT):
            learner.load_state_dict(torch.load(self.path / CHECKPOINT, weights_only=True))

    def drop_checkpoint(self) -> None:
        """Remove the checkpoint of a run that is finished."""
        (self.path / CHECKPOINT).unlink(missing_ok=True)

    def write_results(self, record: dict[str, Any]) -> None:
        """Write results.json."""
        write_json(self.path / RESULTS, record)

    def results(self) -> dict[str, Any]:
        """The content of results.json.

        Raises:
            InvalidArgumentError: the run is not finished, or there is none.
        """
        self.require(RESULTS)
        return json.loads((self.path / RESULTS).read_text())

    def save_policy(self, state: dict[str, Any]) -> None:
        """Write the policies."""
        save_state(self.path / POLICY, state)

    def policy(self) -> dict[str, Any]:
        """The state of the policies.

        Raises:
            InvalidArgumentError: there is none.
        """
        self.require(POLICY)
        return torch.load(self.path / POLICY, weights_only=True)


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {"python": platform.python_version(), "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
    for package in ("torchds", "torch", "numpy", "scipy", "scikit-learn", "cma", "cobyqa", "mujoco"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def write_atomically(path: Path, write: Any) -> None:
    """Call `write(temporary path)`, then move the file into place: readers see the old file or the new one."""
    temporary = path.with_name(f".{path.name}.part")
    write(temporary)
    os.replace(temporary, path)


def save_state(path: Path, content: dict[str, Any]) -> None:
    """Write tensors and plain values atomically."""
    write_atomically(path, lambda temporary: torch.save(content, temporary))


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON atomically."""
    write_atomically(path, lambda temporary: temporary.write_text(json.dumps(content, indent=1) + "\n"))
