"""Tables as text: in Markdown for pages, aligned for the terminal, and as .csv for other programs."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from torchds.files import write_atomically
from torchds.sessions.records import aligned as aligned


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], align: str = "") -> str:
    """A table of a Markdown page; a bar within a cell is escaped.

    Args:
        header: names of the columns.
        rows: one cell for each column.
        align: "l" or "r" for each column, from the first; columns without a letter stand as the reader's program likes.
    """
    rule = [{"r": "---:"}.get(letter, "---") for letter in align.ljust(len(header))]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in (header, *rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (cells[0], rule, *cells[1:]))


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table that spreadsheets open, whole or not at all.

    Args:
        path: of the file.
        header: names of the columns.
        rows: one cell for each column; cells with commas are quoted.

    Raises:
        FileError: the disk is full, read-only or gone.
    """
    text = io.StringIO(newline="")
    csv.writer(text).writerows([header, *rows])
    write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))
