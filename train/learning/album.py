"""What a run shows of a trial beside its numbers: stiffness profile, pictures, and a film, in TensorBoard and as files."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import PIL.Image
from matplotlib.figure import Figure
from tensorboard.compat.proto.summary_pb2 import Summary

from torchds import Rollout, plotting
from torchds.errors import TorchdsError
from torchds.files import write_atomically
from torchds.monitor.events import Events
from train.learning import figures
from train.learning.learner import Learner
from train.statistics import quartiles

FRAMES = 38  # of a film
PLAYED = 8.0  # frames a second
TENTHS = 10  # of a run, with a picture each


class Album:
    """Adds pictures to a run, a few times over its length; where nothing can render, it says so once and goes on."""

    def __init__(self, events: Events, learner: Learner) -> None:
        self.events, self.learner = events, learner
        self.every = max(1, learner.n_updates // TENTHS)
        self._renders = True

    def add(self) -> None:
        """Motion, stiffness profile and last picture of the present policy, at each tenth of the run."""
        path, learner = self.learner.path, self.learner
        if path is None or learner.done % self.every:
            return
        with figures.uncounted(learner.task):
            self._add(path)

    def _add(self, path: Rollout) -> None:
        learner = self.learner
        rollouts = learner.history.rollouts[-1]
        if learner.n_updates >= TENTHS and path.x.shape[-1] == 2:
            self.events.figure("trial/motion", figures.progress(learner, path), rollouts)
        if path.stiffness is not None:
            self.events.figure("stiffness/profile", stiffness_profile(path), rollouts)
        if (picture := self._film(1)) is not None:
            self.events.image("trial/end", picture[0], rollouts)

    def finish(self, folder: Path) -> None:
        """A film of the present policy: in TensorBoard, and as `film.gif` in `folder` beside its last picture."""
        if (film := self._film(FRAMES)) is None:
            return
        moving = gif(film)
        write_atomically(folder / "film.gif", lambda stream: stream.write(moving))
        write_atomically(folder / "trial.png", lambda stream: PIL.Image.fromarray(film[-1]).save(stream, "PNG"))
        image = Summary.Image(height=film.shape[1], width=film.shape[2], colorspace=3, encoded_image_string=moving)
        self.events.add(
            Summary(value=[Summary.Value(tag="trial/film", image=image)]), self.learner.history.rollouts[-1]
        )

    def _film(self, frames: int) -> np.ndarray | None:
        path = self.learner.path
        if path is None or not self._renders:
            return None
        try:
            return self.learner.task.film(path, frames)
        except TorchdsError as error:
            print(f"{error}; the run goes on without pictures")
            self._renders = False
            return None


def gif(film: np.ndarray) -> bytes:
    """Pictures `(F, height, width, 3)` as an animation that stops a while at the end."""
    pictures = [PIL.Image.fromarray(frame).quantize(96) for frame in film]
    duration = [round(1000 / PLAYED)] * (len(film) - 1) + [2000]
    buffer = io.BytesIO()
    pictures[0].save(buffer, "GIF", save_all=True, append_images=pictures[1:], duration=duration, loop=0)
    return buffer.getvalue()


def stiffness_profile(path: Rollout) -> Figure:
    """What stiffness the policy asks for along its motion: median and quartiles over runs and starts, by output."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    assert path.stiffness is not None
    s = path.stiffness.detach().reshape(-1, *path.stiffness.shape[-2:]).numpy(force=True)  # (M, T, Q)
    time = path.dt * np.arange(s.shape[1])
    for q in range(s.shape[-1]):
        low, middle, high = quartiles(s[..., q], axis=0)
        color = plotting.TERMS[q % len(plotting.TERMS)]
        axes.plot(time, middle, color=color, label=f"s{q + 1}" if s.shape[-1] > 1 else "s")
        axes.fill_between(time, low, high, color=color, alpha=0.2, lw=0)
    axes.set(
        xlabel="time [s]", ylabel="stiffness asked for [N/m]", title="Stiffness profile of the policy without noise"
    )
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure
