"""The robot's side of a session, with numpy alone: a reference tick by tick, and what was measured as a recording.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from torchds.archives import existing, reason, write_atomically
from torchds.control.tick import Tick
from torchds.errors import FileError, InvalidArgumentError


class Recorder:
    """Rows of measurements, kept in memory and written at the end.

    Args:
        columns: of the positions and whatever else is measured, with units, as "x [m]"; the time comes before them.
        n: rows that there is room for; a tick allocates nothing.

    Example:
        >>> import tempfile
        >>> recorder = Recorder(("x [m]",), n=2)
        >>> recorder.add(0.0, [1.0])
        >>> recorder.add(0.001, [1.5])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     print(recorder.write(f"{folder}/recording-1.csv").read_text(), end="")
        time [s],x [m]
        0.0,1.0
        0.001,1.5
    """

    def __init__(self, columns: Sequence[str], n: int = 100_000) -> None:
        self.columns, self.rows, self.length = tuple(columns), np.empty((n, 1 + len(columns))), 0

    def add(self, t: float, *values: ArrayLike) -> None:
        """Keep what was measured at a time [s]: arrays or numbers, in the order of the columns.

        Raises:
            InvalidArgumentError: no room is left, or not a number for each column.
        """
        if self.length == len(self.rows):
            raise InvalidArgumentError(f"there is room for {self.length} rows; make the recorder with a larger n=")
        row, at = self.rows[self.length], 1
        row[0] = t
        for value in values:
            part = np.atleast_1d(value)
            if part.ndim != 1 or at + len(part) > len(row):
                at = -1
                break
            row[at : at + len(part)] = part
            at += len(part)
        if at != len(row):
            raise InvalidArgumentError(f"what is measured has to be one number for each of {', '.join(self.columns)}")
        self.length += 1

    def write(self, path: str | Path) -> Path:
        """Write the rows as a table, whole or not at all, and return where.

        Raises:
            FileError: it cannot be written.
        """
        path = Path(path)
        lines = [",".join(("time [s]", *self.columns))]
        lines += [",".join(map(repr, row)) for row in self.rows[: self.length].tolist()]
        text = "\n".join(lines) + "\n"
        write_atomically(path, lambda stream: stream.write(text.encode()))
        return path


class Playback:
    """One roll-out of a session in the loop of a robot: what it has to follow, and the recording of it.

    Args:
        path: of `rollout-<k>.csv`.
        measured: columns that are measured beside the positions, with units.
        velocity: columns of the velocities, as the layout of the session has them; those that begin with `v_` by default.

    Attributes:
        dt: time step of the reference [s].
        position: names of the positions, with units.
        x0: `(C,)` where the robot has to stand at the first tick, at rest.

    Raises:
        FileError: no such file, or it is no reference of a session.
    """

    def __init__(self, path: str | Path, measured: Sequence[str] = (), *, velocity: Sequence[str] = ()) -> None:
        self.path = existing(path)
        header, *lines = self.path.read_text(encoding="utf-8").splitlines() or [""]
        names = header.split(",")
        wanted = tuple(velocity) or tuple(name for name in names if name.startswith("v_"))
        velocities = [i for i, name in enumerate(names) if name in wanted]
        n = len(velocities)
        try:
            self._table = np.array([[float(cell) for cell in line.split(",")] for line in lines])
            fine = names[0] == "time [s]" and n > 0 and velocities == list(range(n + 1, 2 * n + 1)) and len(lines) > 1
            fine = fine and self._table.shape == (len(lines), len(names)) and bool(np.isfinite(self._table).all())
        except ValueError:
            fine = False
        if not fine or not self.path.name.startswith("rollout-"):
            raise FileError(
                f"{self.path} is no reference of a session, as rollout-1.csv is, or its velocities are not the columns "
                f"{', '.join(wanted) or 'that begin with v_'}; give those of the layout, velocity="
            )
        self.position = tuple(names[1 : n + 1])
        self.dt = float(self._table[1, 0])
        self.x0 = self._table[0, 1 : n + 1]
        self.recorder = Recorder((*self.position, *measured), n=len(lines))
        self._ticks = [Tick(row[1:], n, n) for row in self._table]

    @property
    def done(self) -> bool:
        """Whether the motion has ended."""
        return self.recorder.length == len(self._ticks)

    def step(self, x: ArrayLike, *measured: ArrayLike) -> Tick:
        """The row of this tick, where the robot should be now and what holds until the next; what it measures now is kept.

        Args:
            x: `(C,)` measured position.
            *measured: everything else, in the order of the columns.

        Raises:
            InvalidArgumentError: the motion has ended, or not a number for each column.
        """
        if self.done:
            raise InvalidArgumentError(f"{self.path.name} has ended; write() its recording")
        i = self.recorder.length
        self.recorder.add(self._table[i, 0], x, *measured)
        return self._ticks[i]

    def write(self) -> Path:
        """Write `recording-<k>.csv` beside the reference, or mark it as failed where the motion has not ended.

        A motion that has ended takes back the mark that an earlier `write` has left, and no other.

        Raises:
            FileError: it cannot be written.
        """
        recording = self.path.with_name(self.path.name.replace("rollout-", "recording-"))
        mark = recording.with_suffix(".failed")
        if not self.done:
            return self.recorder.write(mark)
        self.recorder.write(recording)
        try:
            if mark.is_file() and mark.read_bytes().startswith(b"time [s],"):
                mark.unlink()
        except OSError as error:
            raise FileError(f"{mark} cannot be removed: {reason(error)}; remove it, the motion has ended") from error
        return recording
