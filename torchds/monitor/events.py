"""TensorBoard's file of a run, which holds every update exactly once, however often the run was interrupted.

All events go to one file of a fixed name, in order, and are on the disk before a checkpoint says how long the file was. A run
that is resumed cuts the file to that length and goes on, so that what came after the checkpoint is written again, once.

Stability: experimental.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from torchds.errors import FileError, MissingPackageError
from torchds.files import reason

if TYPE_CHECKING:
    from matplotlib.figure import Figure

try:
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.summary.writer.record_writer import RecordWriter
    from torch.utils.tensorboard import summary as summaries
except ImportError as error:
    raise MissingPackageError("tensorboard", "monitor", "writing TensorBoard's files") from error

NAME = "events.out.tfevents.run"

BAND = ("", "_q1", "_q3")  # endings of the tags of a median and its quartiles
CHARTS = {
    "cost without noise": {"median and quartiles of the runs": ["Margin", [f"cost/total{end}" for end in BAND]]},
    "cost of what was tried, with noise": {"median and quartiles": ["Margin", [f"cost/tried{end}" for end in BAND]]},
    "terms of the cost without noise": {"medians of the runs": ["Multiline", ["cost/(?!total|tried).*"]]},
    "search": {
        "width of the noise": ["Multiline", ["exploration/lr"]],
        "entropy of the weights [nat]": ["Multiline", ["weights/entropy"]],
    },
}
"""What the page Custom Scalars shows, equal in all runs, so that TensorBoard draws them into the same charts."""


class Events:
    """Writes what TensorBoard shows of a run.

    Args:
        folder: of the run.
        length: bytes of the file that stay, as the checkpoint says; the rest is cut off.

    Attributes:
        lost: whether the file was shorter than that, and is begun anew.

    Raises:
        FileError: the file cannot be written.
    """

    def __init__(self, folder: Path, length: int = 0) -> None:
        self.path = folder / NAME
        try:
            handle = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
            self._file = os.fdopen(handle, "r+b", buffering=0)
            self.lost = os.fstat(handle).st_size < length
            length = 0 if self.lost else length
            os.ftruncate(handle, length)
            self._file.seek(length)
        except OSError as error:
            raise FileError(f"{self.path} cannot be written: {reason(error)}") from error
        self._pending = io.BytesIO()
        self._records = RecordWriter(self._pending)
        if not length:
            self._records.write(Event(wall_time=time.time(), file_version="brain.Event:2").SerializeToString())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.flush()
        finally:
            self.close()

    def close(self) -> None:
        """Close the file; what was not written is lost."""
        self._file.close()

    def write(self) -> int:
        """Bring all events into the file, where TensorBoard sees them; returns its length.

        Raises:
            FileError: the disk is full or gone; the file is as it was, and the next call writes these events too.
        """
        before, data = self._file.tell(), memoryview(self._pending.getvalue())
        try:
            while data:
                data = data[self._file.write(data) :]
            length = self._file.tell()
        except OSError as error:
            with suppress(OSError):  # half a record would hide all that follows
                self._file.seek(before)
                self._file.truncate()
            raise FileError(f"{self.path} cannot be written: {reason(error)}") from error
        self._pending = io.BytesIO()
        self._records = RecordWriter(self._pending)
        return length

    def flush(self) -> int:
        """Bring all events to the disk, where they outlast a loss of power; returns the length of the file.

        Raises:
            FileError: the disk is full or gone.
        """
        length = self.write()
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise FileError(f"{self.path} cannot be written: {reason(error)}") from error
        return length

    def add(self, summary: Summary, step: int) -> None:
        """Append one summary."""
        self._records.write(Event(wall_time=time.time(), step=step, summary=summary).SerializeToString())

    def scalars(self, values: Mapping[str, Any], step: int) -> None:
        """Append numbers by their tags."""
        for tag, value in values.items():
            self.add(Summary(value=[Summary.Value(tag=tag, simple_value=float(value))]), step)

    def image(self, tag: str, picture: np.ndarray[Any, Any], step: int) -> None:
        """Append a picture `(height, width, 3)`."""
        self.add(summaries.image(tag, picture, dataformats="HWC"), step)  # type: ignore[no-untyped-call]

    def figure(self, tag: str, figure: Figure, step: int) -> None:
        """Append a figure."""
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
        width, height = figure.canvas.get_width_height()
        shown = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=buffer.getvalue())
        self.add(Summary(value=[Summary.Value(tag=tag, image=shown)]), step)

    def charts(self) -> None:
        """Append the layout of the page Custom Scalars: medians with their bands in one chart."""
        self.add(summaries.custom_scalars(CHARTS), 0)  # type: ignore[no-untyped-call]

    def options(self, options: Mapping[str, bool | int | float | str]) -> None:
        """Append what the page HParams compares runs by, beside their last scalars.

        An options' name that only some runs have is a column of all: TensorBoard finds the columns in the runs themselves where
        none of them claims to list those of all.
        """
        _, begin, end = summaries.hparams(dict(options), {})  # type: ignore[no-untyped-call]
        for summary in (begin, end):
            self.add(summary, 0)
