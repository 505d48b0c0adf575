"""How roll-outs scale over processes: `python -m train scale measure` and `python -m train scale simulate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import cycle, product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from matplotlib.figure import Figure
from tqdm import tqdm

from torchds import files, plotting
from torchds.errors import InvalidArgumentError, TorchdsError, UnknownNameError
from train.benchmark.scale import simulated
from train.benchmark.scale.measured import CASES, Timing, timed
from train.benchmark.scale.simulated import Times, gather_seconds, lossy, stale, update_seconds
from train.folder import new_folder, versions, write_text
from train.options import LEARNERS, options_for
from train.statistics import median, quartiles, summary
from train.tables import markdown

SHARES = (1.0, 0.99, 0.95, 0.9, 0.8, 0.5)
STALENESS = (0, 1, 2, 4, 8)
BETWEEN = {"an hour": 3600.0, "a day": 86400.0, "a month": 30 * 86400.0}
"""Mean time between two failures of one worker [s]."""
NEVER = 1e6  # s
HEAD = (
    "",
    "processes",
    "update [ms]",
    "over one process",
    "processor time [ms]",
    "over one process",
    "gather and wait [ms]",
    "gather alone [ms]",
    "messages",
    "bytes of a process",
)


@dataclass
class Scale:
    """Measure runs by a few processes, or simulate an update by many."""

    action: Annotated[Literal["measure", "simulate"], tyro.conf.Positional]
    """measure: time runs by processes of this machine. simulate: many workers, from what was measured."""
    processes: tuple[int, ...] = (1, 2, 4)
    """measure: how many at once."""
    only: str = ""
    """measure: only cases with this text in their name."""
    repeats: int = 3
    """measure: how often; all numbers of processes take turns."""
    workers: tuple[int, ...] = (10, 1000, 100_000)
    """simulate: how many at once."""
    runs: int = 20
    """simulate: learning runs behind each median."""
    updates: int = 50
    """simulate: of these runs."""
    patience: float = 600.0
    """simulate: after which a silent worker counts as failed [s]."""
    restart: float = 10.0
    """simulate: what a restart of all processes takes [s]."""
    rollout: tuple[float, float] | None = None
    """simulate: mean time of a roll-out [s] and standard deviation of its logarithm; if not given, digging is timed here."""
    size: float = 180e3
    """simulate: what a process sends in an update [bytes]; scale measure says how many they are."""
    network: tuple[float, float] = (50e-6, 1e9)
    """simulate: latency of a message [s], and bytes that a process sends in a second."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where to write: LOGDIR/scale/."""

    def main(self) -> Path:
        """Measure or simulate; returns the folder with the tables.

        Raises:
            InvalidArgumentError: numbers out of range.
            UnknownNameError: no case with this name.
        """
        if min((*self.processes, *self.workers, self.repeats, self.runs, self.updates)) < 1 or self.patience <= 0:
            raise InvalidArgumentError(
                "--processes, --workers, --repeats, --runs and --updates have to be at least 1 and --patience positive, got "
                f"{self.processes}, {self.workers}, {self.repeats}, {self.runs}, {self.updates} and {self.patience}"
            )
        text, drawn = self.measure() if self.action == "measure" else self.simulate()
        folder = new_folder(self.logdir / "scale")
        write_text(folder / f"{self.action}.md", text)
        files.write_json(folder / "versions.json", versions())
        print(text)
        if drawn is not None:
            plotting.save(folder / "simulated.png", drawn())
        print(f"all of it in {folder}")
        return folder

    # ------------------------------------------------------------------ measure

    def measure(self) -> tuple[str, None]:
        """The table of all cases and numbers of processes, and what this machine cannot run."""
        names = [name for name in CASES if self.only in name]
        if not names:
            raise UnknownNameError("case", self.only, CASES)
        found: dict[tuple[str, int], list[Timing]] = {}
        failed: dict[tuple[str, int], str] = {}
        for name, _, n in tqdm(list(product(names, range(self.repeats), self.processes))):
            if (name, n) not in failed:
                try:
                    found.setdefault((name, n), []).append(timed(name, n))
                except TorchdsError as error:
                    failed[name, n] = str(error)
        lines = [self.line(name, n, found) for name in names for n in self.processes if (name, n) not in failed]
        cannot = [f"{name}, {n} process(es) cannot be had: {why}" for (name, n), why in failed.items()]
        return "\n\n".join([markdown(HEAD, lines), *cannot]) + "\n", None

    def line(self, name: str, n: int, found: dict[tuple[str, int], list[Timing]]) -> list[str]:
        """A line of the table: medians over the repeats, ratios of what was measured one after the other."""
        mine, one = found[name, n], found.get((name, 1), [])
        cells = [name, str(n)]
        for what in ("update", "busy"):
            values = [getattr(timing, what) for timing in mine]
            ratios = [value / getattr(timing, what) for value, timing in zip(values, one, strict=False)]
            cells += [summary([1e3 * value for value in values]), summary(ratios) if ratios and n > 1 else ""]
        if n == 1:
            return [*cells, "", "", "", ""]
        waits = [f"{1e3 * median([getattr(timing, what) for timing in mine]):.3g}" for what in ("together", "gather")]
        return [*cells, *waits, str(mine[0].messages), str(mine[0].bytes)]

    # ------------------------------------------------------------------ simulate

    def simulate(self) -> tuple[str, Callable[[], Figure]]:
        """Tables of many workers, and what draws their figure."""
        times = self.times()
        waits = {
            (between, workers): [self.waits(failing, workers, share) for share in SHARES]
            for between, failing in self.failing(times).items()
            for workers in self.workers
        }
        learned = self.learned()
        lines = [
            [
                f"{workers:,}",
                between,
                *(f"{seconds:.3g}" for seconds in row),
                self.restarted(workers, between, times),
                f"{gather_seconds(workers, self.size, *self.network):.3g}",
            ]
            for (between, workers), row in waits.items()
        ]
        head = ("workers", "one fails once in", *(f"{share:g}" for share in SHARES), "all, with restarts", "gather")
        said = f"A roll-out takes {times.mean:.3g} s; the logarithm of its time has a standard deviation of {times.spread:.3g}."
        parts = [said, f"Seconds until a share of the roll-outs has come:\n\n{markdown(head, lines)}"]
        for what, row in learned.items():
            head = ("learner", *(f"{value:g}" for value in row[0]))
            parts.append(
                f"{what}:\n\n{markdown(head, [[name, *map(summary, costs)] for name, costs in row[1].items()])}"
            )
        return "\n\n".join(parts) + "\n", partial(draw, waits, learned)

    def waits(self, times: Times, workers: int, share: float, patience: float | None = None) -> float:
        """The mean wait of an update [s], over fewer updates of many workers, since these vary less."""
        updates, rng = max(50, min(5000, 10_000_000 // workers)), np.random.default_rng(0)
        return float(np.mean(update_seconds(times, workers, share, patience or self.patience, updates, rng)))

    def times(self) -> Times:
        """Those of the digging, tried here, one after the other; or those that were given."""
        if self.rollout is not None:
            return Times(*self.rollout, 0.0)
        return Times.of(np.asarray(simulated.rollout_seconds(options_for("lwr_digging", grains="coarse"), 30)), 0.0)

    def failing(self, times: Times) -> dict[str, Times]:
        """The same with workers that fail."""
        return {name: times._replace(failure=1 - np.exp(-times.mean / seconds)) for name, seconds in BETWEEN.items()}

    def restarted(self, workers: int, between: str, times: Times) -> str:
        """Mean time until an update was made in one go, where each failure of a worker restarts all of them."""
        whole = self.waits(times, workers, 1.0, np.inf)
        rate = workers / BETWEEN[between]  # of failures, of which none may come for the time `whole`
        seconds = (1 / rate + self.restart) * np.expm1(rate * whole)
        return f"{seconds:.3g}" if seconds < NEVER else "never"

    def learned(self) -> dict[str, tuple[tuple[float, ...], dict[str, list[np.ndarray]]]]:
        """Final costs on N of both learners, by the share that comes in time and by the age of the parameters."""
        found: dict[str, tuple[tuple[float, ...], dict[str, list[np.ndarray]]]] = {}
        for what, values in (("min_share", SHARES), ("updates old", STALENESS)):
            rows: dict[str, list[np.ndarray]] = {}
            for (name, learner), n in tqdm(list(product(LEARNERS.items(), (10, 100)))):
                if name != "pibb" and n > 10:
                    continue
                options = options_for("via_point", runs=self.runs, updates=self.updates, rollouts=n, **learner)
                wraps = [lossy(value, 0) if what == "min_share" else stale(int(value)) for value in values]
                rows[f"{name}, {n} roll-outs"] = [simulated.final_costs(options, wrap) for wrap in wraps]
            found[f"Final cost on N, by {what}"] = tuple(map(float, values)), rows
        return found


def draw(waits: dict[tuple[str, int], list[float]], learned: dict[str, Any]) -> Figure:
    """How long an update waits, and what is learned from what has come."""
    figure = Figure(figsize=(13, 4), layout="constrained")
    axes = figure.subplots(1, 3)
    styles = dict(zip(BETWEEN, ("-", "--", ":"), strict=True))
    left = [100 * (1 - share) for share in SHARES]
    colors = dict(zip(sorted({n for _, n in waits}), cycle(plotting.TERMS), strict=False))
    for (between, n), row in waits.items():
        name = f"{n:,} workers" if between == next(iter(BETWEEN)) else None
        axes[0].plot(left, row, styles[between], color=colors[n], marker=".", label=name)
    for between, style in styles.items():
        axes[0].plot([], [], style, color="gray", label=f"one fails once in {between}")
    axes[0].set(xlabel="roll-outs left behind [%]", ylabel="an update waits [s]", yscale="log")
    axes[0].set_xscale("symlog", linthresh=1)
    axes[0].set(xlim=(-0.1, 70), xticks=left, xticklabels=[f"{share:.0f}" for share in left])
    axes[0].minorticks_off()
    for panel, (what, (values, rows)) in zip(axes[1:], learned.items(), strict=True):
        for color, (name, costs) in zip(cycle(plotting.TERMS), rows.items(), strict=False):
            low, middle, high = quartiles(np.stack(costs), axis=1)
            x = left if what.endswith("min_share") else values
            panel.plot(x, middle, color=color, marker=".", label=name)
            panel.fill_between(x, low, high, color=color, alpha=0.15, lw=0)
        panel.set(ylabel="final cost on N", yscale="log")
    axes[1].set(xlabel="roll-outs left behind [%]")
    axes[2].set(xlabel="parameters that are tried are so many updates old")
    for panel in axes:
        panel.grid(alpha=0.3)
        panel.legend(fontsize=7)
    return figure
