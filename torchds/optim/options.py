"""The options that all policy searches share, declared and described once.

Stability: stable.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Literal, TypedDict

import torch

from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.optim.functional import Temperature, cost_weights

ControlReference = Literal["demonstrated", "zero"]
Elite = Literal["none", "nominal", "best"]


class SharedOptions(TypedDict, total=False):
    """Options of every policy search.

    Shared options:
        eliteness: h; the larger, the more the best roll-outs count. A group may have its own.
        temperature: the spread of costs that h divides: "range" (the paper), "median" or "capped"; see
            `functional.cost_weights`. A group may have its own.
        control_weight: r of the control cost R = r I. A group may have its own.
        control_reference: what the control cost is measured from: "demonstrated", the demonstrated policy (Eq. 12-13), or
            "zero" (Eq. 11).
        elite: what the first of the N roll-outs is: "none", a perturbed policy like the others; "nominal", the unperturbed
            policy (footnote 3); "best", from the second step on, the cheapest policy tried so far, tried again.
        batched: True: the closure is called once while every parameter carries N in front, and returns `(N, *batch)`.
            False: it is called N times, for any module, simulator or robot, and returns `(*batch)`.
        generator: of the unit normals, on the CPU; None for a new one with a fixed seed.
    """

    eliteness: float
    temperature: Temperature
    control_weight: float
    control_reference: ControlReference
    elite: Elite
    batched: bool
    generator: torch.Generator | None


DEFAULTS: SharedOptions = {
    "eliteness": 10.0,
    "temperature": "range",
    "control_weight": 0.0,
    "control_reference": "demonstrated",
    "elite": "none",
    "batched": True,
    "generator": None,
}


def completed(given: SharedOptions, defaults: SharedOptions, search: type) -> SharedOptions:
    """`given` with `defaults` for what it does not say.

    Args:
        given: what a caller passed.
        defaults: those of the search.
        search: the class, whose signature says what else it knows.

    Raises:
        UnknownNameError: an option that the search does not have; lists those that it has.
        InvalidArgumentError: a `control_reference` or `elite` that does not exist.
    """
    for name in given:
        if name not in defaults:
            own = [p.name for p in inspect.signature(search).parameters.values() if p.kind is not p.VAR_KEYWORD]
            raise UnknownNameError(f"option of {search.__name__}", name, [*own, *defaults])
    options: SharedOptions = {**defaults, **given}
    if options["control_reference"] not in ("demonstrated", "zero"):
        raise InvalidArgumentError(
            f"control_reference has to be 'demonstrated' or 'zero', got {options['control_reference']!r}"
        )
    if options["elite"] not in ("none", "nominal", "best"):
        raise InvalidArgumentError(f"elite has to be 'none', 'nominal' or 'best', got {options['elite']!r}")
    return options


def check_group(group: Mapping[str, Any]) -> None:
    """Refuse shared options of a group that are out of their range.

    Raises:
        InvalidArgumentError: what was received and what is allowed.
    """
    for name in ("lr", "control_weight"):
        if not group[name] >= 0:
            raise InvalidArgumentError(f"{name} has to be ≥ 0, got {group[name]}")
    if not group["eliteness"] > 0:
        raise InvalidArgumentError(f"eliteness has to be positive, got {group['eliteness']}")
    cost_weights(torch.zeros(1), temperature=group["temperature"])  # refuses names that it does not know


def described(defaults: SharedOptions) -> str:
    """What `help` of a search says about its shared options: their meaning, and its defaults."""
    meaning = inspect.cleandoc(SharedOptions.__doc__ or "").partition("\n\n")[2]
    values = ", ".join(f"{name}={value!r}" for name, value in defaults.items())
    return f"{meaning}\n\nDefaults of the shared options:\n    {values}"
