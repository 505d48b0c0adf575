"""How fast everything is: `python -m train benchmark`."""

from __future__ import annotations

import copy
import datetime
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from tqdm import tqdm

from torchds.errors import FileError, InvalidArgumentError, TorchdsError, UnknownNameError
from torchds.files import write_atomically
from train.benchmark.floor import Floor, compile_floor, run_floor
from train.benchmark.rows import N_STEPS, Row, rows
from train.folder import versions
from train.options import options_for
from train.statistics import median, quartiles
from train.tables import markdown

HEADER = ("", "over the floor", "median", "quartiles", "floor")


@dataclass
class Benchmark:
    """Time roll-outs, learning and fits on one thread; ratios to a C++ program of the same algorithm come first."""

    repeats: int = 5
    """How often each is timed."""
    updates: int = 50
    """Policy updates of a learning run."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where roll-outs and learning are timed."""
    only: str = ""
    """Time only rows with this text in their name."""
    json: Path | None = None
    """Write everything to this file."""
    against: Path | None = None
    """Compare with a file that --json wrote, and name what is slower by more than both spreads."""

    def main(self) -> None:
        """Time all rows, print the table, and compare it.

        Raises:
            InvalidArgumentError: no repeats, or a file of another device to compare with.
            UnknownNameError: no row with this text in its name.
            FileError: see `read`.
        """
        if self.repeats < 1:
            raise InvalidArgumentError(f"--repeats has to be at least 1, got {self.repeats}")
        before = None if self.against is None else read(self.against)
        options = options_for("via_point", device=self.device)
        task: Any = options.make_task()
        policy = task.policy().requires_grad_(False)
        if before is not None and before["device"] != self.name():
            raise InvalidArgumentError(
                f"--against {self.against} has the times of {before['device']}, and here is {self.name()}; give a file of it"
            )
        every = list(rows(task, policy, self.device, self.updates))
        wanted = [row for row in every if self.only in row.name]
        if not wanted:
            raise UnknownNameError("row", self.only, [row.name for row in every])
        timed: list[dict[str, Any]] = []
        with tempfile.TemporaryDirectory() as folder:
            program = compile_floor(Path(folder))
            if program is None:
                print("no C++ compiler here that works (g++, clang++ or c++): there is no floor to compare with")
            for row in tqdm(wanted):
                try:
                    seconds = measure(self.finished(row.call), self.repeats)
                    floor = None if program is None or row.floor is None else self.floor(program, row, policy)
                except (TorchdsError, torch.cuda.OutOfMemoryError):
                    continue  # this machine cannot
                timed.append(entry(row, seconds, floor))
        found = {
            "date": datetime.date.today().isoformat(),
            "versions": versions(),
            "device": self.name(),
            "rows": timed,
        }
        print(table(found))
        if self.json is not None:
            content = json.dumps(found, indent=1).encode()
            write_atomically(self.json, lambda stream: stream.write(content))
        if before is not None:
            print(compared(found, before, self.only))

    def floor(self, program: Path, row: Row, policy: Any) -> list[float]:
        """Seconds of the C++ program for the work of a row."""
        assert row.floor is not None
        kind, n = row.floor
        task: Any = options_for("via_point").make_task()
        steps = N_STEPS if kind == "passes" else task.motion().n_steps
        updates = 0 if kind == "passes" else self.updates
        measured: Floor = run_floor(program, task, copy.deepcopy(policy).to("cpu"), n, steps, updates, self.repeats)
        return [row.share * seconds for seconds in getattr(measured, kind)]

    def finished(self, call: Callable[[], object]) -> Callable[[], None]:
        """`call`, and all that it has begun."""

        def finish() -> None:
            call()
            if self.device == "cuda":
                torch.cuda.synchronize()

        return finish

    def name(self) -> str:
        """The device in words."""
        return "cpu, one thread" if self.device == "cpu" else torch.cuda.get_device_name()


def measure(call: Callable[[], object], repeats: int) -> list[float]:
    """Seconds of each of `repeats` calls, after one that may compile; what takes less than 10 ms is called 100 times."""

    def seconds(n: int) -> float:
        began = time.perf_counter()
        for _ in range(n):
            call()
        return (time.perf_counter() - began) / n

    call()
    first = seconds(1)
    return (
        [seconds(100) for _ in range(repeats)] if first < 0.01 else [first, *(seconds(1) for _ in range(repeats - 1))]
    )


def entry(row: Row, seconds: list[float], floor: list[float] | None) -> dict[str, Any]:
    """A row of the file: seconds [s], and over the floor's."""
    low, middle, high = (float(value) for value in quartiles(seconds))
    ratio = None if floor is None else middle / median(floor)
    return {
        "name": row.name,
        "ratio": ratio,
        "median": middle,
        "quartiles": [low, high],
        "floor": None if floor is None else median(floor),
    }


def table(found: dict[str, Any]) -> str:
    """Everything as a page has it."""
    body = []
    for row in found["rows"]:
        ratio = "" if row["ratio"] is None else f"{row['ratio']:{'.1f' if row['ratio'] > 0.1 else '.1g'}}"
        floor = "" if row["floor"] is None else in_words(row["floor"])
        low, high = row["quartiles"]
        body.append((row["name"], ratio, in_words(row["median"]), f"{in_words(low)} to {in_words(high)}", floor))
    said = ", ".join(f"{name} {value}" for name, value in found["versions"].items())
    return f"{found['date']}; {found['device']}; {said}\n\n{markdown(HEADER, body, 'lrrrr')}"


def compared(found: dict[str, Any], before: dict[str, Any], only: str = "") -> str:
    """What is slower than it was: the lower quartile now is above the upper one before; and what cannot be compared.

    Args:
        found: what was timed now.
        before: the other file.
        only: text in the names of the rows that were asked for.
    """
    now, then = ({row["name"]: row for row in rows["rows"] if only in row["name"]} for rows in (found, before))
    both = [name for name in now if name in then]
    slower = [
        f"slower: {name}: {in_words(now[name]['median'])}, was {in_words(then[name]['median'])}"
        for name in both
        if now[name]["quartiles"][0] > then[name]["quartiles"][1]
    ]
    alone = [f"not compared: {name}: not in the file of {before['date']}" for name in now if name not in then]
    alone += [f"not compared: {name}: not timed now" for name in then if name not in now]
    told = slower or [f"of {len(both)} rows none is slower than on {before['date']} by more than the spread"]
    return "\n".join(told + alone)


def read(path: Path) -> dict[str, Any]:
    """A file of an earlier benchmark.

    Raises:
        FileError: there is none, or it is another kind of file.
    """
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        assert (
            found["date"]
            and found["device"]
            and all(row["name"] and row["median"] and row["quartiles"] for row in found["rows"])
        )
    except (OSError, ValueError, KeyError, TypeError, AssertionError) as error:
        raise FileError(f"{path}: not a file of python -m train benchmark --json ({error})") from error
    return found


def in_words(seconds: float) -> str:
    """Three digits in a unit that fits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"
