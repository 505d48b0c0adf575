"""The files between a session and a robot: references to execute, and the recordings or costs that come back.

Tables are comma-separated under a header of names with units; numbers keep all their digits. Letters: `N` roll-outs, `T`
steps, `C` positions and `M` measured quantities. docs/hardware.md is the page for whoever writes or reads them on the robot's
side.

Stability: experimental.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchds.errors import FileError
from torchds.files import existing, reason, write_text
from torchds.recordings.csv import names_of
from torchds.recordings.text import read_text
from torchds.sessions.layout import TIME, Layout

COSTS = "costs.csv"

FRESH, LOOK = 1.0, 0.2
"""A file that was changed less than FRESH seconds ago is looked at again LOOK seconds later."""

State = Literal["there", "failed", "missing"]


class Recorded(NamedTuple):
    """What was measured along motions, at the control steps.

    Attributes:
        x: `(..., T+1, C)` positions.
        measured: `(..., T, M)` at the ends of the steps.
    """

    x: Tensor
    measured: Tensor


def control_times(n_steps: int, dt: float) -> np.ndarray:
    """The T+1 times of the control steps [s], without digits that come from binary fractions alone."""
    return np.round(np.arange(n_steps + 1) * dt, 9)


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Write a table atomically; floats are read back bit for bit."""
    write_text(path, table_text(header, rows))


def table_text(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table as a text."""
    return "\n".join([",".join(header), *(",".join(map(str, row)) for row in rows)]) + "\n"


def reference_text(layout: Layout, x: Tensor, v: Tensor, stiffness: Tensor, dt: float) -> str:
    """What a robot has to follow as a table, T+1 rows; velocity and stiffness hold from their row to the next.

    Args:
        layout: of the columns.
        x: `(T+1, C)` positions.
        v: `(T, C)` velocities; the last row says zero.
        stiffness: `(T, Q)`; the last row says the last again.
        dt: time step [s].
    """
    t = torch.from_numpy(control_times(len(v), dt)).to(x).unsqueeze(-1)
    at_rest, held = torch.cat([v, torch.zeros_like(v[:1])]), torch.cat([stiffness, stiffness[-1:]])
    return table_text(layout.reference, torch.cat([t, x, at_rest, held], -1).tolist())


def read_recording(layout: Layout, path: Path, start: Tensor, n_steps: int, dt: float) -> Recorded:
    """Read what a robot measured, at any rate, and bring it to the control steps.

    Positions go through a cubic spline, since their second differences count, all else through straight lines. A recording at
    the control steps themselves is taken as it is.

    Args:
        layout: of the columns; others are ignored.
        path: of the table.
        start: `(C,)` the first point of the reference.
        n_steps: T.
        dt: time step [s].

    Raises:
        FileError: a file that is no table of finite numbers, columns that are not there or have another unit,
            times that do not increase, leave a gap, or do not cover the motion, or a start elsewhere.
    """
    t, x, measured = recorded_columns(layout, path)
    times = control_times(n_steps, dt)
    check_times(path, t, times, clock_jump(t, x, layout.lever), layout.max_gap)
    for name, found, wanted, allowed in zip(layout.position, x[0], start.tolist(), layout.start, strict=False):
        if abs(found - wanted) > allowed:
            raise FileError(
                f"{path}: the motion starts at {name} = {found:g}, its reference at {wanted:g}. They have to agree within "
                f"{allowed:g}: same base frame, tool point and units."
            )
    return Recorded(
        torch.from_numpy(resample(t, x, times, degree=3)),
        torch.from_numpy(resample(t, measured, times, degree=1)[1:]),
    )


def recorded_columns(layout: Layout, path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times `(samples,)`, positions `(samples, C)` and all else `(samples, M)` of a recording as they stand in the file.

    Raises:
        FileError: a file that is no table, that is half-written, or lacks columns or finite numbers in them.
    """
    check_whole(path)
    text = read_text(path)
    header = names_of(path, text, {})
    if absent := [name for name in layout.recording if name not in header and name not in layout.optional]:
        may = f" ({', '.join(layout.optional)} may be left out)" if layout.optional else ""
        raise FileError(
            f"{path}: no column {', '.join(map(repr, absent))}. The columns have to be {', '.join(layout.recording)}{may}, "
            f"units included; the header says {', '.join(header)}."
        )
    columns = {name: text.numbers(header.index(name)) for name in layout.recording if name in header}
    for name, column in columns.items():
        for row in np.flatnonzero(~np.isfinite(column))[:1]:
            raise FileError(
                f"{path}, line {text.lines[row]}, column {name!r}: {text.cells[row][header.index(name)].strip()!r} is not a "
                f"finite number; correct the line or remove it (values are separated by {text.form})"
            )
    for name in layout.optional:
        columns.setdefault(name, np.zeros(len(text.cells)))
    x, measured = (
        np.stack([columns[name] for name in names], -1) if names else np.empty((len(text.cells), 0))
        for names in (layout.position, layout.measured)
    )
    return columns[TIME], x, measured


def read_recordings(
    layout: Layout, folder: Path, states: Sequence[State], starts: Tensor, n_steps: int, dt: float
) -> Recorded:
    """Read the recordings that are there; the robot stands still in those that are not.

    Args:
        layout: of the columns.
        folder: of the update.
        states: `[N]` what has come back, see `returned`.
        starts: `(C,)` or `(N, C)` the first points of the references.
        n_steps: T.
        dt: time step [s].

    Returns:
        All of them, N in front.

    Raises:
        FileError: see `read_recording`.
    """
    recordings = [
        read_recording(layout, recording(folder, k), start, n_steps, dt)
        if state == "there"
        else Recorded(start.expand(n_steps + 1, -1), start.new_zeros(n_steps, len(layout.measured)))
        for k, (state, start) in enumerate(zip(states, starts.expand(len(states), -1), strict=True), 1)
    ]
    return Recorded(*(torch.stack(field) for field in zip(*recordings, strict=True)))


def check_whole(path: Path) -> None:
    """Refuse a file from elsewhere that is half-written: a number that is cut in the middle is a number, too.

    Raises:
        FileError: its last line does not end.
    """
    if (text := existing(path).read_bytes()) and not text.endswith((b"\n", b"\r")):
        raise FileError(
            f"{path}: ends within a line, as a file does that is half-written; wait until it is whole, and end its last line "
            "with a newline"
        )


def check_settled(paths: Sequence[Path]) -> None:
    """Refuse files that somebody is writing now; where one was changed a moment ago, it is looked at twice.

    Raises:
        FileError: which one grows.
    """

    def look() -> list[tuple[int, int]]:
        return [((stat := path.stat()).st_size, stat.st_mtime_ns) for path in paths]

    before = look()
    if all(abs(time.time_ns() - changed) > 1e9 * FRESH for _, changed in before):
        return
    time.sleep(LOOK)
    for path, then, now in zip(paths, before, look(), strict=True):
        if then != now:
            raise FileError(f"{path}: somebody is writing it; tell again when it is whole")


def clock_jump(t: np.ndarray, x: np.ndarray, lever: Sequence[float]) -> str:
    """A jump of the clock in words: a long step of time in which the robot moved no further than in a short one."""
    step, usual = np.diff(t), np.median(np.diff(t))
    way = np.linalg.norm(np.diff(x, axis=0) * lever, axis=1)
    for i in np.flatnonzero(step > max(5 * usual, 0.02)):
        around = np.r_[max(i - 5, 0) : i, i + 1 : min(i + 6, len(step))]
        speed = np.median(way[around] / np.maximum(step[around], 1e-9))
        if speed > 1e-3 and way[i] < 0.3 * speed * step[i]:
            return f"the clock jumps by {step[i]:.3g} s at {t[i]:.4g} s, where samples are {usual:.3g} s apart"
    return ""


def check_times(path: Path, t: np.ndarray, times: np.ndarray, jump: str, max_gap: float) -> None:
    """Refuse sample times `t` that do not cover the motion at `times`; a `jump` of the clock is told with it.

    Raises:
        FileError: what is wrong with them.
    """
    steps = np.diff(t)
    if steps.min() <= 0:
        at = int(steps.argmin()) + 1
        raise FileError(f"{path}: the time has to increase, but {t[at]:g} s follows {t[at - 1]:g} s.")
    longest = max(max_gap, times[1] + 1e-9)
    if steps.max() > longest:
        at = int(steps.argmax())
        raise FileError(
            f"{path}: nothing between {t[at]:g} and {t[at + 1]:g} s. Samples have to be at most {longest:g} s apart."
            f"{jump and f' Or {jump}.'}"
        )
    slack = max(np.median(steps), times[1]) + 1e-9
    if abs(t[0]) > slack or abs(t[-1] - times[-1]) > slack:
        raise FileError(
            f"{path}: lasts from {t[0]:g} to {t[-1]:g} s, the motion from 0 to {times[-1]:g} s. They have to agree within one "
            f"sample: cut the recording, or mark the roll-out as failed if the robot stopped.{jump and f' Or {jump}.'}"
        )


def resample(t: np.ndarray, values: np.ndarray, times: np.ndarray, degree: int) -> np.ndarray:
    """Values `(samples, D)` at other times, by a spline through all of them; held before the first and after the last."""
    if np.array_equal(t, times):
        return values
    from scipy.interpolate import make_interp_spline

    spline: np.ndarray = make_interp_spline(t, values, degree)(times.clip(t[0], t[-1]))
    return spline


def read_costs(path: Path, n: int) -> dict[int, float]:
    """Read a table with the columns rollout and cost: infinity where the cost is empty or says "failed".

    Raises:
        FileError: another header, or a line that names no roll-out from 1 to n, names one again, or has no
            finite cost.
    """
    check_whole(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *lines = [[cell.strip() for cell in line] for line in csv.reader(file) if line] or [[]]
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"{path}: not a text file of comma-separated values ({reason(error)})") from error
    if header != ["rollout", "cost"]:
        raise FileError(f"{path}: the header has to be rollout,cost, it is {','.join(header)!r}.")
    costs: dict[int, float] = {}
    for line in lines:
        try:
            rollout, cost = int(line[0]), math.inf if line[1] in ("", "failed") else float(line[1])
            usable = len(line) == 2 and 1 <= rollout <= n and rollout not in costs
            usable = usable and (math.isfinite(cost) or line[1] in ("", "failed"))
        except (ValueError, IndexError):
            usable = False
        if not usable:
            raise FileError(
                f"{path}: {','.join(line)!r} is no line like 3,1.25 or 3,failed with a roll-out from 1 to {n}, each once."
            )
        costs[rollout] = cost
    return costs


def returned(folder: Path, n: int) -> list[State]:
    """What has come back of the roll-outs 1 to n; a mark recording-<k>.failed counts more than a recording beside it.

    Raises:
        FileError: recordings and costs both, or costs that cannot be read.
    """
    costs = read_costs(folder / COSTS, n) if (folder / COSTS).is_file() else {}
    states: list[State] = []
    for k in range(1, n + 1):
        recorded = recording(folder, k).is_file()
        if recorded and (folder / COSTS).is_file():
            raise FileError(f"{folder}: has recordings and {COSTS}. Leave one of them.")
        failed = failure(folder, k).exists() or math.isinf(costs.get(k, 0.0))
        states.append("failed" if failed else "there" if recorded or k in costs else "missing")
    return states


def reference(folder: Path, k: int) -> Path:
    """What roll-out k has to follow."""
    return folder / f"rollout-{k}.csv"


def recording(folder: Path, k: int) -> Path:
    """The recording of roll-out k."""
    return folder / f"recording-{k}.csv"


def failure(folder: Path, k: int) -> Path:
    """The mark of a roll-out that failed, whatever it holds."""
    return folder / f"recording-{k}.failed"
