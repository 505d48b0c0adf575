"""TensorBoard's file of a run, which holds every update exactly once, however often the run was interrupted.

All events go to one file of a fixed name, in order, and are on the disk before a checkpoint says how long the file was. A run
that is resumed cuts the file to that length and goes on, so that what came after the checkpoint is written again, once.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from matplotlib.figure import Figure
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard.summary import hparams, image, scalar

from torchds.errors import FileError
from torchds.files import reason

NAME = "events.out.tfevents.run"


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
            self._file.close()

    def flush(self) -> int:
        """Bring all events to the disk; returns the length of the file.

        Raises:
            FileError: the disk is full or gone.
        """
        data = self._pending.getbuffer()
        try:
            while data:
                data = data[self._file.write(data) :]
            os.fsync(self._file.fileno())
            length = self._file.tell()
        except OSError as error:
            raise FileError(f"{self.path} cannot be written: {reason(error)}") from error
        self._pending = io.BytesIO()
        self._records = RecordWriter(self._pending)
        return length

    def add(self, summary: Summary, update: int) -> None:
        """Append one summary."""
        self._records.write(Event(wall_time=time.time(), step=update, summary=summary).SerializeToString())

    def scalar(self, tag: str, value: Any, update: int) -> None:
        """Append a number."""
        self.add(scalar(tag, float(value)), update)

    def image(self, tag: str, picture: np.ndarray, update: int) -> None:
        """Append a picture `(height, width, 3)`."""
        self.add(image(tag, picture, dataformats="HWC"), update)

    def figure(self, tag: str, figure: Figure, update: int) -> None:
        """Append a figure."""
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
        width, height = figure.canvas.get_width_height()
        shown = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=buffer.getvalue())
        self.add(Summary(value=[Summary.Value(tag=tag, image=shown)]), update)

    def hyper_parameters(self, options: Mapping[str, Any], metrics: Mapping[str, float]) -> None:
        """Append what TensorBoard compares runs by."""
        for summary in hparams(dict(options), dict(metrics)):
            self.add(summary, 0)
        for name, value in metrics.items():
            self.scalar(name, value, 0)
