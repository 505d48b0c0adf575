"""The runs of a sweep as rows of the report that `compare` writes: those that differ by their seeds alone are one row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tasks.loading import short
from train.compare.report import Outcome
from train.compare.sweep.spec import Job
from train.options import RunOptions
from train.searchers.named import METHODS

NAMED = ("seed", "optimizer", "exploration", "shape", "logdir")  # they have places of their own in a row


def rows(jobs: Sequence[Job], records: Mapping[str, dict[str, Any]], failures: Mapping[str, str]) -> list[Outcome]:
    """The rows.

    Args:
        jobs: all of them.
        records: the content of results.json by the name of the job, of those that are done.
        failures: why others failed.
    """
    values = [job.options.to_json() for job in jobs]
    varying = [
        name
        for name in dict.fromkeys(name for each in values for name in each)
        if name not in NAMED and len({repr(each[name]) for each in values if name in each}) > 1
    ]
    groups: dict[tuple[str, str], list[Job]] = {}
    for job in jobs:
        groups.setdefault((problem(job.options), label(job.options, varying)), []).append(job)
    found = []
    for (which, how), members in groups.items():
        made = [records[job.name] for job in members if job.name in records]
        method = METHODS.get(members[0].options.optimizer)
        gradient = method is not None and method.gradient
        why = [failures[job.name] for job in members if job.name in failures]
        if made:
            random = len(made) > 1 or len(made[0]["cost"][-1]) > 1 or method is None or method.random
            found.append(Outcome(which, how, together(made), random=random, gradient=gradient))
        if why:
            found.append(
                Outcome(which, f"{how} ({len(why)} failed)" if made else how, refused="; ".join(sorted({*why})))
            )
    return found


def problem(options: RunOptions) -> str:
    """What is learned."""
    shape = getattr(options, "shape", None)
    return options.name if shape is None else f"{options.name}-{shape}"


def label(options: RunOptions, varying: Sequence[str]) -> str:
    """The optimizer with the options that differ between jobs, and what it searches along where that is not the task's own."""
    said = options.to_json()
    own = [f"{name}={short(str(said[name]))}" for name in varying if name in said]
    usual = type(options)().exploration
    along = "" if options.exploration == usual else f", {short(options.exploration)}"
    return " ".join([short(options.optimizer), *own]) + along


def together(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Runs of several seeds as if they had been one batch."""
    first = records[0]
    terms = {name: beside([each["terms"][name] for each in records]) for name in first["terms"]}
    return {
        **first,
        "cost": beside([each["cost"] for each in records]),
        "terms": terms,
        "failed": [sum(counts) for counts in zip(*(each["failed"] for each in records), strict=True)],
        "seconds": sum(each["seconds"] for each in records),
    }


def beside(tables: Sequence[list[list[float]]]) -> list[list[float]]:
    """Tables `[U+1][runs]` of several runs as one."""
    joined: list[list[float]] = [[cost for row in lines for cost in row] for lines in zip(*tables, strict=True)]
    return joined
