"""The runs of a sweep as rows of the report that `compare` writes: those that differ by their seeds alone are one row."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tasks import options_of
from tasks.loading import told_apart
from train.compare.report import Outcome
from train.compare.sweep.spec import Job
from train.options import RunOptions, usual_values
from train.searchers.named import METHODS

CALLED = ("optimizer", "exploration")  # as tables call them
NAMED = ("seed", "shape", "logdir", *CALLED)  # they have places of their own in a row
Names = Mapping[str, Mapping[str, str]]  # what tables call each value of an option


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
    names = {name: told_apart(str(each[name]) for each in values if name in each) for name in (*CALLED, *varying)}
    names["task"] = told_apart([job.options.task for job in jobs], lambda spec: options_of(spec).name)
    groups: dict[str, list[Job]] = {}
    for job in jobs:
        groups.setdefault(but_seed(job.options), []).append(job)
    found = []
    for members in groups.values():
        options = members[0].options
        which, how = problem(options, names), label(options, names, varying)
        made = [records[job.name] for job in members if job.name in records]
        method = METHODS.get(options.optimizer)
        gradient = method is not None and method.gradient
        why = [failures[job.name] for job in members if job.name in failures]
        if made:
            record = together(made)
            differ = any(len(np.unique(costs)) > 1 for costs in record["cost"])
            random = differ or method is None or method.random
            found.append(Outcome(which, how, record, random=random, gradient=gradient))
        if why:
            found.append(
                Outcome(which, f"{how} ({len(why)} failed)" if made else how, refused="; ".join(sorted({*why})))
            )
    return found


def but_seed(options: RunOptions) -> str:
    """What runs that differ by their seeds alone have in common."""
    said = {name: value for name, value in options.to_json().items() if name not in ("seed", "logdir")}
    return json.dumps([options.task, said], sort_keys=True)


def problem(options: RunOptions, names: Names) -> str:
    """What is learned."""
    shape, name = getattr(options, "shape", None), names["task"][options.task]
    return name if shape is None else f"{name}-{shape}"


def label(options: RunOptions, names: Names, varying: Sequence[str]) -> str:
    """The optimizer with the options that differ between jobs, and what it searches along where that is not the task's own."""
    said = options.to_json()
    own = [f"{name}={names[name][str(said[name])]}" for name in varying if name in said]
    along = (
        ""
        if options.exploration == usual_values(options)["exploration"]
        else f", {names['exploration'][options.exploration]}"
    )
    return " ".join([names["optimizer"][options.optimizer], *own]) + along


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
