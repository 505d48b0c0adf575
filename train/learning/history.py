"""What a learning run has cost so far: its history, the content of results.json, and the closing table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from torchds.errors import InvalidArgumentError
from train.folder import versions
from train.statistics import of_costs
from train.tables import aligned


@dataclass
class History:
    """Noise-free costs after every update, the initial policy first.

    Attributes:
        rollouts: `[U+1]` roll-outs spent.
        cost: `[U+1][runs]`.
        terms: name -> `[U+1][runs]`.
        failed: `[U+1]` roll-outs without a finite cost, all runs together.
        forward_equivalents: `[U+1]` what was computed, in roll-outs without gradients: a roll-out with its gradient counts as
            four, the Jacobian behind noise along the motion as two.
        seconds: spent learning.
    """

    rollouts: list[int] = field(default_factory=list)
    cost: list[list[float]] = field(default_factory=list)
    terms: dict[str, list[list[float]]] = field(default_factory=dict)
    failed: list[int] = field(default_factory=list)
    forward_equivalents: list[int] = field(default_factory=list)
    seconds: float = 0.0

    @classmethod
    def of(cls, fields: Mapping[str, Any], runs: int) -> History:
        """The history that `dataclasses.asdict` made `fields` of.

        Raises:
            InvalidArgumentError: not as many lines in all columns, or not a cost for each of the runs.
        """
        history = cls(**fields)
        n = len(history.cost)
        columns: list[Sequence[Any]] = [
            history.rollouts,
            history.failed,
            history.forward_equivalents,
            *history.terms.values(),
        ]
        costs = [row for rows in (history.cost, *history.terms.values()) for row in rows]
        if any(len(column) != n for column in columns) or any(len(row) != runs for row in costs):
            raise InvalidArgumentError(f"its history is not one of {runs} run(s): columns or lines are missing")
        return history

    def add(self, rollouts: int, terms: dict[str, Tensor], failed: int, forward_equivalents: int) -> None:
        """Append one evaluation, terms `(runs,)` each."""
        self.rollouts.append(rollouts)
        self.forward_equivalents.append(forward_equivalents)
        self.cost.append(torch.stack(list(terms.values())).sum(0).tolist())
        for name, values in terms.items():
            self.terms.setdefault(name, []).append(values.tolist())
        self.failed.append(failed)


def results(task: str, options: dict[str, Any], history: History) -> dict[str, Any]:
    """The content of results.json."""
    return {
        "task": task,
        "options": options,
        "versions": versions(),
        "rollouts": history.rollouts,
        "forward_equivalents": history.forward_equivalents,
        "cost": history.cost,
        "terms": history.terms,
        "failed": history.failed,
        "seconds": round(history.seconds, 3),
    }


def table(history: History) -> str:
    """Initial and final cost by term: median and quartiles over runs; the bare cost of one run."""
    columns, rows = {"total": history.cost, **history.terms}, []
    if len(history.cost[-1]) == 1:
        return aligned(("cost", "initial", "final"), [(name, v[0][0], v[-1][0]) for name, v in columns.items()])
    for name, values in columns.items():
        q1, middle, q3 = of_costs(values[-1])
        rows.append((name, of_costs(values[0])[1], middle, f"[{q1:.4g}, {q3:.4g}]"))
    return aligned(("cost", "initial", "final: median", "[q1, q3]"), rows)
