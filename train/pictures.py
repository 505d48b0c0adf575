"""Figures as files."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from torchds.files import write_atomically


def save_figure(path: Path, figure: Figure, dpi: int = 130) -> None:
    """Write a picture, whole or not at all.

    Args:
        path: of the file, which ends in .png.
        figure: that is drawn.
        dpi: dots per inch.

    Raises:
        FileError: the disk is full, read-only or gone.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    write_atomically(path, lambda stream: stream.write(buffer.getbuffer()))
