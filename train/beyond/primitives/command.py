"""A dynamical system and a movement primitive learn the same letters, and are disturbed: `python -m train primitives`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import tasks
from torchds import plotting
from torchds.errors import InvalidArgumentError
from torchds.files import write_json
from train.beyond.primitives.disturbed import disturbances, follow, measures
from train.beyond.primitives.figure import draw
from train.beyond.primitives.rows import Row, Seen
from train.folder import new_folder, versions, write_text
from train.learning.learner import Learner
from train.learning.run import check, distinct
from train.options import LEARNERS, RunOptions, options_for
from train.statistics import differ, of_costs, quartiles
from train.tables import markdown

SHAPES = ("N", "P")
SYSTEMS = {"gmr": "dynamical system", "dmp": "movement primitive"}
WAYS: dict[str, dict[str, Any]] = {
    "pibb": LEARNERS["pibb"],
    "pi2": {"optimizer": "pi2", "exploration": "homogeneous"},
    "recommended": LEARNERS["recommended"],
    "adam": {"optimizer": "adam", "exploration": "homogeneous"},
}
DISTURBED = "recommended"  # whose policies are disturbed


@dataclass
class Primitives:
    """A dynamical system and a movement primitive of as many parameters: how they learn, and what they do when disturbed."""

    runs: int = 20
    """Learning runs of each row, in one batch; where nothing is random, one."""
    seed: int = 0
    """Of the exploration noise."""
    updates: int | None = None
    """Policy updates of ten roll-outs; the task's own number if not given."""
    distance: float = 1.5
    """Of pushes and of other starts [unit of the task, 4 mm]."""
    seconds: float = 8.0
    """For which a motion is held, of its 40."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where to write: LOGDIR/primitives/."""

    def main(self) -> Path:
        """Learn, disturb, write tables and the figure, and return their folder.

        Raises:
            InvalidArgumentError: numbers out of range.
        """
        check(RunOptions(seed=self.seed, updates=self.updates))
        if self.runs < 2 or not self.distance > 0 or not 0 < self.seconds < 20:
            raise InvalidArgumentError(
                f"--runs of at least 2, a positive --distance and --seconds between 0 and 20 are needed, got {self.runs}, "
                f"{self.distance} and {self.seconds}"
            )
        folder = new_folder(self.logdir / "primitives")
        tried = [tasks.make("via_point", shape=shape, system=system) for shape in SHAPES for system in SYSTEMS]
        names = [(task, way) for task in tried for way in WAYS]
        rows = [self.row(*name) for name in tqdm(names, unit="row", dynamic_ncols=True)]
        seen = [each for row in rows if row.way == DISTURBED for each in self.disturbed(row)]
        text = page(rows, seen, self)
        write_text(folder / "report.md", text)
        plotting.save(folder / "primitives.png", draw(rows, seen))
        write_json(folder / "costs.json", {"options": self.to_json(), "versions": versions(), "rows": records(rows)})
        print(text)
        print(f"report.md, primitives.png and costs.json in {folder}")
        return folder

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "logdir": str(self.logdir)}

    def row(self, task: Any, way: str) -> Row:
        """The system of a via-point task, learned in one way."""
        shape, system = task.shape, task.system
        options = options_for(
            "via_point", shape=shape, system=system, runs=self.runs, seed=self.seed, updates=self.updates, **WAYS[way]
        )
        learner = Learner(distinct(options, task), task).learn()
        terms = {name: np.array(values) for name, values in learner.history.terms.items() if name != "control"}
        return Row(shape, system, way, learner, np.sum(list(terms.values()), 0))

    def disturbed(self, row: Row) -> Iterator[Seen]:
        """The learned policies of all runs, undisturbed first."""
        task, whole = row.learner.task, None
        (via_points,) = task.scene().via_points.values()
        for each in disturbances(task.motion(), self.distance, self.seconds):
            x = follow(row.learner.policy, task.motion(), each)
            whole = x if whole is None else whole
            yield Seen(row, each, x, measures(x, whole, each, task.scene().goal, via_points))


def records(rows: list[Row]) -> list[dict[str, Any]]:
    """The learning curves as plain values."""
    return [
        {
            "shape": r.shape,
            "system": r.system,
            "way": r.way,
            "rollouts": r.learner.history.rollouts,
            "cost": r.cost.tolist(),
        }
        for r in rows
    ]


def page(rows: list[Row], seen: list[Seen], options: Primitives) -> str:
    """The report."""
    runs = f"{options.runs} seeds (adam: one run, nothing is random)"
    parts = [
        "# A dynamical system and a movement primitive",
        f"Costs of the task, without the control cost: medians over {runs}; p of the two-sided Mann-Whitney test between both "
        "systems.",
        learned(rows),
        f"What becomes of the policies of the learner '{DISTURBED}': medians and quartiles over {runs} and {len(seen[1].x[0])} "
        f"directions of pushes and starts, of {options.distance:g} units; held for {options.seconds:g} s.",
        became(seen),
        "![Learning curves, and disturbed motions](primitives.png)",
        ", ".join(f"{name} {value}" for name, value in {**options.to_json(), **versions()}.items()),
    ]
    return "\n\n".join(parts) + "\n"


def learned(rows: list[Row]) -> str:
    """The table of costs at the beginning, on the way and at the end."""
    lines = []
    for row in rows:
        rollouts = row.learner.history.rollouts
        marks = [min(range(len(rollouts)), key=lambda i, m=m: abs(rollouts[i] - m)) for m in (0, 100, 200)]  # type: ignore[misc]
        (other,) = (r for r in rows if (r.shape, r.way) == (row.shape, row.way) and r.system != row.system)
        both = len(row.cost[-1]) > 1 and row.system == "dmp"
        q1, middle, q3 = of_costs(row.cost[-1])
        costs = [f"{of_costs(row.cost[m])[1]:.3g}" for m in marks]
        p = f"{differ(row.cost[-1].tolist(), other.cost[-1].tolist()):.1g}" if both else ""
        lines.append((row.shape, SYSTEMS[row.system], row.way, *costs, f"{middle:.3g} [{q1:.3g}, {q3:.3g}]", p))
    end = rows[0].learner.history.rollouts[-1]
    return markdown(("", "system", "learner", "initial", "after 100", "after 200", f"after {end}", "p"), lines)


def became(seen: list[Seen]) -> str:
    """The table of what disturbances did."""
    lines = []
    for each in seen:
        cells = ["{1:.2f} [{0:.2f}, {2:.2f}]".format(*quartiles(value.flatten().tolist())) for value in each.measured]
        lines.append((each.row.shape, each.disturbance.name, SYSTEMS[each.row.system], *cells))
    lines.sort(key=lambda line: (line[0], [s.disturbance.name for s in seen].index(line[1])))
    head = ("via-points passed, of 1", "from the goal at the end", "from its path", "from its schedule")
    return markdown(("", "disturbance", "system", *head), lines)
