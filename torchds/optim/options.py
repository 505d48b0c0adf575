"""The options that all policy searches share, declared and described once.

Stability: stable.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from typing import Any, Literal, TypedDict, get_args

import torch

from torchds.arrays import count, number, shown
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.optim.functional import Temperature, check_temperature

ControlReference = Literal["demonstrated", "zero"]
Elite = Literal["none", "nominal", "best"]
CONTROL_REFERENCES, ELITES = get_args(ControlReference), get_args(Elite)


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

IN_GROUPS = ("eliteness", "temperature", "control_weight")
"""The shared options that each group may have its own of."""


def completed(given: SharedOptions, defaults: SharedOptions, search: type) -> SharedOptions:
    """`given` with `defaults` for what it does not say.

    Args:
        given: what a caller passed.
        defaults: those of the search.
        search: the class, whose signature says what else it knows.

    Raises:
        UnknownNameError: an option that the search does not have; lists those that it has.
    """
    for name in given:
        if name not in defaults:
            own = [p.name for p in inspect.signature(search).parameters.values() if p.kind is not p.VAR_KEYWORD]
            raise UnknownNameError(f"option of {search.__name__}", name, [*own, *defaults])
    return {**defaults, **given}


def check_search(
    n_rollouts: Any, elite: Any, control_reference: Any, batched: Any, generator: Any
) -> tuple[int, torch.Generator]:
    """Refuse options of a search as a whole that are out of their range.

    Returns:
        N as int, and the generator.

    Raises:
        InvalidArgumentError: what was received and what is allowed.
    """
    for name, value, allowed in (
        ("control_reference", control_reference, CONTROL_REFERENCES),
        ("elite", elite, ELITES),
    ):
        if not isinstance(value, str) or value not in allowed:
            *others, last = map(repr, allowed)
            raise InvalidArgumentError(f"{name} has to be {', '.join(others)} or {last}, got {shown(value)}")
    n_rollouts = count("n_rollouts", n_rollouts, 1)
    if elite != "none" and n_rollouts < 2:
        raise InvalidArgumentError(f"elite={elite!r} needs n_rollouts ≥ 2, got {n_rollouts}")
    if not isinstance(batched, bool):
        raise InvalidArgumentError(f"batched has to be True or False, got {shown(batched)}")
    if generator is None:
        generator = torch.Generator().manual_seed(0)
    if not isinstance(generator, torch.Generator) or generator.device.type != "cpu":
        seed = generator if isinstance(generator, int) else 0
        raise InvalidArgumentError(
            f"generator has to be a torch.Generator on the CPU, got {shown(generator)}; use "
            f"torch.Generator().manual_seed({seed})"
        )
    return n_rollouts, generator


def check_group(group: Mapping[str, Any]) -> None:
    """Refuse shared options of a group that are missing or out of their range.

    Raises:
        InvalidArgumentError: what was received and what is allowed.
    """
    if missing := [name for name in ("lr", *IN_GROUPS) if name not in group]:
        raise InvalidArgumentError(f"a group needs the options {missing}, got {sorted(group)}")
    for name in ("lr", "control_weight"):
        number(name, group[name], "≥ 0", lambda value: value >= 0)
    number("eliteness", group["eliteness"], "positive", lambda value: value > 0)
    for name in ("lr", "control_weight", "eliteness"):
        number(name, group[name], "finite", math.isfinite)
    check_temperature(group["temperature"])


def described(defaults: SharedOptions) -> str:
    """What `help` of a search says about its shared options: their meaning, and its defaults."""
    meaning = inspect.cleandoc(SharedOptions.__doc__ or "").partition("\n\n")[2]
    values = ", ".join(f"{name}={value!r}" for name, value in defaults.items())
    return f"{meaning}\n\nDefaults of the shared options:\n    {values}"
