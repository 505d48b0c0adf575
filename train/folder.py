"""The folder of a run: which files it has, that they are verified when they are read, and whose they are."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import torchds
from tasks import Task
from tasks.loading import bare
from tasks.plain import plain
from torchds import GMRPolicy, files, kernels, load_policy
from torchds.dmp import DMP
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.files import make_folder as make_folder
from torchds.files import write_text as write_text
from torchds.locks import one_writer
from train.options import RunOptions, options_class, usual_values

OPTIONS, CHECKPOINT, RESULTS, POLICY = "options.json", "checkpoint.pt", "results.json", "policy.pt"
RECORD = ("task", "options", "versions", "rollouts", "forward_equivalents", "cost", "terms", "failed", "seconds")
"""What results.json holds."""


class Interrupted(Exception):
    """The run was stopped from the keyboard; its folder can be resumed."""


class Resumable(Protocol):
    """What a checkpoint is made of, and loaded into."""

    options: RunOptions
    history: Any

    def state_dict(self) -> dict[str, Any]:
        """All that is needed to continue."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where the state was taken."""


class RunFolder:
    """What a run leaves behind, and what it resumes from.

    `options.json` holds `{"task", "options", "versions"}` and is there from the beginning, `checkpoint.pt` what the learner
    needs to continue and whose it is, `results.json` what `train.learning.history.results` says, and `policy.pt` the
    policies; the last two are there in the end. Each has a digest of its content and is verified when it is read. Readers see
    an old file or a new one, never a half.

    Args:
        path: of the folder, which need not be there.
        option: of the command that named it, for messages.
    """

    def __init__(self, path: Path, option: str = "") -> None:
        self.path, self.option = path, option

    @classmethod
    def new(cls, logdir: Path, task: str, optimizer: str, seed: int) -> RunFolder:
        """Make LOGDIR/<task>/<optimizer>/<time>-<seed>/, a new one in any case."""
        return cls(new_folder(logdir / task / optimizer, f"-{seed}"))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Be the only one who writes here, in a folder that is made where it is missing.

        Raises:
            FileError: another process works here, or the folder cannot be written to.
        """
        make_folder(self.path)
        with one_writer(self.path):
            yield

    def has(self, name: str) -> bool:
        """Whether a file is there."""
        return (self.path / name).is_file()

    def require(self, *names: str) -> None:
        """Refuse a folder that lacks one of the files.

        Raises:
            InvalidArgumentError: which ones are missing.
        """
        missing = [name for name in names if not self.has(name)]
        if missing == [POLICY] and self.has(RESULTS):
            raise InvalidArgumentError(
                f"{self.option} {self.path}: no {POLICY} there, which runs of primitives (--system dmp), of compare and of "
                "sweep do not leave; give the folder of another one".strip()
            )
        if missing:
            kind = "run" if names == (OPTIONS,) else "finished run"
            raise InvalidArgumentError(
                f"{self.option} {self.path}: no {', '.join(missing)} there; give the folder of a {kind}, below logs/".strip()
            )

    def begin(self, task: str, options: dict[str, Any]) -> None:
        """Make the folder where it is missing, and write down what is to be run."""
        make_folder(self.path)
        files.write_sealed(self.path / OPTIONS, {"task": task, "options": options, "versions": versions()})

    def options(self) -> RunOptions:
        """Those that it was begun with.

        Raises:
            InvalidArgumentError: no run is there, or one with options that this version does not know.
            FileError: the file is damaged, or not of a run.
        """
        self.require(OPTIONS)
        path = self.path / OPTIONS
        content = files.read_sealed(path, unsealed=("task", "options"))
        task, options = content.get("task"), content.get("options")
        if not isinstance(task, str) or not isinstance(options, dict):
            raise FileError(f"{path} holds no options of a run")
        try:
            return options_class(task).from_json(options)
        except (InvalidArgumentError, UnknownNameError) as error:
            raise InvalidArgumentError(f"{path}: {error}") from error

    # ------------------------------------------------------------------ checkpoints

    def save_checkpoint(self, learner: Resumable, events: int = 0) -> None:
        """Keep the state of a learner, with all that says whose it is.

        Args:
            learner: as it stands.
            events: bytes of TensorBoard's file that belong to it.
        """
        said = {"task": learner.options.task, "options": learner.options.to_json(), "versions": versions()}
        files.save(self.path / CHECKPOINT, "checkpoint", {**said, "events": events, "learner": learner.state_dict()})

    def restore(self, learner: Resumable) -> int:
        """Bring a learner to the last checkpoint; where there is none yet, it stays as it is.

        Returns:
            The bytes of TensorBoard's file that belong to it; 0 without a checkpoint.

        Raises:
            FileError: the checkpoint is damaged, or belongs to another run; the message says what differs.
        """
        if not self.has(CHECKPOINT):
            return 0
        path = self.path / CHECKPOINT
        content = load(path, "checkpoint", ("task", "options", "versions", "events", "learner"))
        check_identity(path, content, learner.options)
        say_versions(path, content["versions"])
        try:
            learner.load_state_dict(content["learner"])
        except InvalidArgumentError as error:
            raise FileError(f"{path} does not fit this run: {error}") from error
        if not learner.history.cost:
            raise FileError(f"{path} holds an empty history; remove it to begin the run anew")
        return int(content["events"])

    def drop_checkpoint(self) -> None:
        """Remove the checkpoint of a run that is finished."""
        (self.path / CHECKPOINT).unlink(missing_ok=True)

    # ------------------------------------------------------------------ what is there in the end

    def write_results(self, record: dict[str, Any]) -> None:
        """Write results.json."""
        files.write_sealed(self.path / RESULTS, record)

    def results(self) -> dict[str, Any]:
        """The content of results.json; costs that were not finite are NaN.

        Raises:
            InvalidArgumentError: the run is not finished, or there is none.
            FileError: the file is damaged, or not of a run.
        """
        self.require(RESULTS)
        content = files.read_sealed(self.path / RESULTS, unsealed=RECORD)
        if missing := [name for name in RECORD if name not in content]:
            raise FileError(
                f"{self.path / RESULTS} is no result of a run of this version: no {', '.join(missing)} in it"
            )
        return {**content, "cost": numbers(content["cost"]), "terms": numbers(content["terms"])}

    def save_policy(self, policy: GMRPolicy, task: Task) -> None:
        """Write the policies, with what the task says about them; primitives have no file, the checkpoint has their weights."""
        if isinstance(policy, DMP):
            return
        policy.save(self.path / POLICY, **task.about(policy))

    def policy(self) -> GMRPolicy:
        """The policies.

        Raises:
            InvalidArgumentError: there is none.
            FileError: the file is damaged.
        """
        self.require(POLICY)
        return load_policy(self.path / POLICY)


# ------------------------------------------------------------------ whose a file is


def load(path: Path, kind: str, names: Iterable[str]) -> dict[str, Any]:
    """The content of a file of tensors, verified, with all of these names in it.

    Raises:
        FileError: it is damaged, of another kind, or lacks a name.
    """
    content = files.load(path, kind)
    if missing := [name for name in names if name not in content]:
        raise FileError(f"{path} is no {kind} of this version: no {', '.join(missing)} in it")
    return content


def check_identity(path: Path, content: Mapping[str, Any], options: RunOptions) -> None:
    """Refuse a file of another run: another task, or another value of an option that decides about what is learned.

    The number of updates may differ, since a run can be extended, and so may its folder, the threads and the device. Files of
    problems and classes go by their names: what is kept on several machines is found by what they hold (`kept.key`).

    Raises:
        FileError: what differs.
    """
    here, usual = options.to_json(), usual_values(options)
    there = plain(content["options"])  # older checkpoints hold tuples and infinities as they were
    differing = [
        f"{name} {there.get(name, usual.get(name))} there and {here[name]} here"
        for name in here
        if name not in ("updates", "logdir", "threads", "device")
        and bare(there.get(name, usual.get(name))) != bare(here[name])
    ]
    if bare(content["task"]) != bare(options.task):
        differing.insert(0, f"task {content['task']} there and {options.task} here")
    if differing:
        raise FileError(f"{path} belongs to another run: {', '.join(differing)}")


def say_versions(path: Path, written: Mapping[str, str]) -> None:
    """Say on stderr where a file was written with other versions: what follows may then differ in its last digits."""
    here = versions()
    if differing := [
        f"{name} {written.get(name)}, here {here.get(name)}"
        for name in here | dict(written)
        if here.get(name) != written.get(name)
    ]:
        print(f"note: {path} was written with {'; '.join(differing)}: last digits may differ", file=sys.stderr)


def versions() -> dict[str, str]:
    """Versions of what a result depends on, and whether roll-outs are fused (`torchds.kernels`)."""
    return {**_versions(), "roll-outs": "eager" if kernels.wanted("auto") == "eager" else "fused"}


@cache
def _versions() -> dict[str, str]:
    found = {
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "torchds": torchds.__version__,  # what runs: a checkout may be newer than what was installed
    }
    for package in ("torch", "numpy", "numba", "scipy", "scikit-learn", "cma", "cobyqa", "mujoco"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


# ------------------------------------------------------------------ folders and texts


def new_folder(parent: Path, ending: str = "") -> Path:
    """Make PARENT/<time><ending>, a new one in any case."""
    stem = f"{time.strftime('%Y%m%d-%H%M%S')}{ending}"
    make_folder(parent)
    for path in (parent / (stem if i == 0 else f"{stem}.{i}") for i in range(1000)):
        try:
            path.mkdir()
        except FileExistsError:
            continue
        except OSError as error:
            raise FileError(f"the folder {path} cannot be made: {files.reason(error)}; give another one") from error
        return path
    raise FileError(f"cannot make a new folder like {parent / stem}")


def numbers(value: Any) -> Any:
    """Lists and dicts with NaN where JSON has null."""
    if isinstance(value, dict):
        return {name: numbers(item) for name, item in value.items()}
    if isinstance(value, list):
        return [numbers(item) for item in value]
    return float("nan") if value is None else value
