"""What can be taken along from the page, as the bytes of files."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

import torch
from matplotlib.figure import Figure

from tasks.sketch import Problem
from tasks.sketch.script import script
from torchds import plotting
from torchds.files import make_folder
from train.learning.figures import draw_scene
from train.view.studio.side import stem
from train.view.studio.state import Studio

PROBLEMS = "problems"  # the folder of those that scripts read


def problem(studio: Studio) -> bytes:
    """A file that `python -m train` takes."""
    return written(".json", studio.problem.write)


def demonstrations(studio: Studio) -> bytes:
    """An .npz file that `torchds.load` reads."""
    return written(".npz", studio.problem.demonstrations().save_npz)


def policies(studio: Studio) -> bytes:
    """A file that `torchds.load_policy` reads: the policies of all runs of the first learner, or else the imitated one."""
    picture = studio.fresh(0)
    policy, task = studio.settled()
    policy = policy if picture is None else picture.policies
    return written(".pt", lambda path: policy.save(path, **task.about(policy)))


def program(studio: Studio) -> bytes:
    """The Python script that does the same; the problem that it reads is kept below the page's folder, and stays what it is."""
    folder, name = studio.folder / PROBLEMS, stem(studio.problem)
    make_folder(folder)
    paths = (folder / f"{name}{'' if i == 1 else f'_{i}'}.json" for i in count(1))
    path = next(path for path in paths if not path.exists() or Problem.read(path) == studio.problem)
    studio.problem.write(path)
    return script(path).encode()


def svg(studio: Studio) -> bytes:
    """What is on the table, in lines."""
    return picture(studio, "svg")


def png(studio: Studio) -> bytes:
    """What is on the table, in pixels."""
    return picture(studio, "png")


@torch.no_grad()
def picture(studio: Studio, kind: str) -> bytes:
    """What is on the table, as "svg" or "png"."""
    found, task = studio.settled()
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    axes = figure.subplots()
    path = task.rollout(found)
    draw_scene(axes, task, found, path.x)
    if task.source is not None:
        plotting.demonstrations(axes, task.source)
    plotting.gaussians(axes, found)
    learned = found is not (studio.imitation and studio.imitation.policy)
    if learned and studio.imitation is not None and not studio.imitating:
        before = task.rollout(studio.imitation.policy).x
        plotting.trajectories(axes, before, color=plotting.BEFORE, label="imitated motion", lw=1.6)
    label = "learned motion" if learned else "imitated motion"
    plotting.trajectories(axes, path.x, color=plotting.AFTER, label=label)
    plotting.finish_map(axes, studio.problem.name, task.scene().unit)
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=150)
    return stream.getvalue()


def written(ending: str, write: Callable[[Path], object]) -> bytes:
    """What `write` puts into a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{ending}"
        write(path)
        return path.read_bytes()
