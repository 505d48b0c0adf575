"""Tables in text files: which separator, which decimal sign, where the header is, and the cells.

Stability: experimental.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchds.errors import FileError
from torchds.files import existing, reason

COMMENTS = ("#", "%", "//")
SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "spaces"}
MISSING = {"", "na", "n/a", "null", "none", "-", "nan", "+nan", "-nan"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)
WHOLE = re.compile(r"[+-]?\d{1,30}", re.ASCII)
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
SEEN = 200  # lines that the separator is judged by


class Text(NamedTuple):
    """A table as it stands in a file.

    Attributes:
        header: names of the columns; None where the file has none.
        cells: rows of cells, decimals with a point.
        lines: number of the line in the file, of each row.
        breaks: rows in front of which blank lines stand.
        form: what separates cells, in words.
    """

    header: list[str] | None
    cells: list[list[str]]
    lines: list[int]
    breaks: list[int]
    form: str

    def numbers(self, column: int) -> np.ndarray:
        """Of one column `(T,)`; NaN where a cell holds none."""
        return np.array([number(row[column]) for row in self.cells], dtype=float)

    def is_text(self, column: int) -> bool:
        """Whether some cell of a column is neither a number nor missing."""
        return any(not is_number(row[column]) and not is_missing(row[column]) for row in self.cells)

    def whole(self, column: int) -> np.ndarray | None:
        """The column as whole numbers of any size, None where one is missing, if it is written so."""
        cells = [row[column].strip() for row in self.cells]
        if not all(WHOLE.fullmatch(cell) or is_missing(cell) for cell in cells):
            return None
        return np.array([None if is_missing(cell) else int(cell) for cell in cells], dtype=object)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, infinity included."""
    return NUMBER.fullmatch(cell.strip()) is not None


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no number."""
    return cell.strip().lower() in MISSING


def number(cell: str) -> float:
    """The number in a cell, NaN where there is none."""
    return float(cell) if is_number(cell) else math.nan


def read_text(path: str | Path) -> Text:
    """The table in a text file: separated by commas, semicolons, tabs or spaces, with or without a header and comments.

    Raises:
        FileError: no such file, no text, or rows of different lengths; the message gives the line.
    """
    path = existing(path)
    try:
        content = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not a text file of comma-separated values in UTF-8 ({reason(error)})") from error
    except OSError as error:
        raise FileError(f"{path} cannot be read: {reason(error)}") from error
    if "\0" in content:
        raise FileError(f"{path}: not a text file of comma-separated values (it holds null bytes)")
    lines, breaks, comment = _lines(content)
    separator, comma = _separator([line for _, line in lines[:SEEN]])
    try:
        rows = [cells(line, separator, comma) for _, line in lines]
        named = None if comment is None else cells(comment, separator, False)
    except csv.Error as error:
        raise FileError(f"{path}: not a text file of comma-separated values ({error})") from error
    form = SEPARATORS[separator] + (", decimals by a comma" if comma else "")
    header, first = _header(rows, named)
    numbers = [n for n, _ in lines][first:]
    columns = len(header) if header is not None else len(rows[0]) if rows else 0
    for n, row in zip(numbers, rows[first:], strict=True):
        if len(row) != columns:
            raise FileError(
                f"{path}, line {n}: {len(row)} values under {columns} column names; fill or remove the line (values are "
                f"separated by {form})"
            )
    return Text(header, rows[first:], numbers, sorted({b - first for b in breaks if first < b < len(rows)}), form)


def _lines(content: str) -> tuple[list[tuple[int, str]], list[int], str | None]:
    """Lines with their numbers from 1, rows in front of which blank lines stand, and the last comment before the first row."""
    lines: list[tuple[int, str]] = []
    breaks: list[int] = []
    comment = None
    for n, line in enumerate(content.splitlines(), 1):
        if not line.strip(" \t,;"):
            breaks.append(len(lines))
        elif line.lstrip().startswith(COMMENTS):
            if not lines:
                comment = line.lstrip().lstrip("#%/").strip()
        else:
            lines.append((n, line))
    return lines, breaks, comment


def cells(line: str, separator: str, comma: bool) -> list[str]:
    """The cells of one line; with `comma`, decimals are written with one and get a point."""
    if separator == " ":
        found = line.split()
    else:
        (found,) = csv.reader([line], delimiter=separator, skipinitialspace=True)
        found = [cell.strip() for cell in found]
    return [cell.replace(",", ".") if comma and DECIMAL_COMMA.fullmatch(cell) else cell for cell in found]


def _separator(lines: Sequence[str]) -> tuple[str, bool]:
    """The separator under which most cells are numbers in rows of one length, and whether decimals have a comma."""
    best, found = (-1.0, 0), (",", False)
    for separator in SEPARATORS:
        for comma in (False, True) if separator != "," else (False,):
            try:
                rows = [cells(line, separator, comma) for line in lines]
            except csv.Error:
                continue
            lengths = [len(row) for row in rows]
            if not rows or max(lengths) < 2:
                continue
            usual = max(set(lengths), key=lengths.count)
            good = sum(is_number(cell) or is_missing(cell) for row in rows if len(row) == usual for cell in row)
            score = (good / sum(lengths), usual)
            if score[0] > best[0] + 1e-9:
                best, found = score, (separator, comma)
    return found


def _header(rows: Sequence[Sequence[str]], comment: list[str] | None) -> tuple[list[str] | None, int]:
    """The names of the columns, and how many rows they take."""
    if not rows:
        return comment, 0
    first, second = rows[0], rows[1] if len(rows) > 1 else []
    words = [not is_number(cell) and not is_missing(cell) for cell in first]
    above = [word and i < len(second) and is_number(second[i]) for i, word in enumerate(words)]
    if all(words) or any(above) or (any(words) and not any(map(is_number, first))):
        return list(first), 1
    if comment is not None and len(comment) == len(first) and not any(map(is_number, comment)):
        return comment, 0
    return None, 0
