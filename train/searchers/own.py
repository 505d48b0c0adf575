"""Optimizers and explorations of yours, named by the place where their class stands: FILE.py:NAME or MODULE:NAME.

An optimizer is a subclass of `torchds.optim.PolicySearch` and is made as those of `torchds.optim` are:
`MyOptimizer(parameters, lr=, exploration=, n_rollouts=, temperature=, elite=, control_weight=, generator=)`. An exploration
is a subclass of `torchds.exploration.Exploration` and is made as `MyExploration(policy)`, or as
`MyExploration(policy, noise)` where `--noise` is given; the policy has one batch dimension, the runs.
"""

from __future__ import annotations

import inspect
from typing import Any, TypeVar

from tasks.loading import load_object
from torchds.errors import InvalidArgumentError

T = TypeVar("T")


def make_own(option: str, spec: str, base: type[T], *values: Any, **keywords: Any) -> T:
    """An object of the class that stands at `spec`.

    Args:
        option: that named it, for messages.
        spec: "my_file.py:Name" or "my_package.module:Name".
        base: what the class has to be a subclass of.
        *values: what it is made with, in this order.
        **keywords: what it is made with, by name.

    Raises:
        InvalidArgumentError: nothing stands there, or something that is no `base`, or is not made with these arguments.
        UnknownNameError: the file has no class of this name.
    """
    own: Any = load_object(spec, base)
    try:
        inspect.signature(own).bind(*values, **keywords)
    except TypeError as error:
        taken = ", ".join([type(value).__name__ for value in values] + [f"{name}=" for name in keywords])
        raise InvalidArgumentError(
            f"--{option} {spec}: {own.__name__} has to be made with ({taken}), got one that cannot: {error}; let its __init__ "
            "take them, or inherit it"
        ) from error
    return own(*values, **keywords)
