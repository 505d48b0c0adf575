"""State that a search takes along and comes back with: all of it in its own dtype, checked before anything changes.

Stability: experimental.
"""

from __future__ import annotations

import copy
import functools
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor, nn

from torchds.arrays import shown
from torchds.errors import InvalidArgumentError, TorchdsError
from torchds.exploration.base import Exploration
from torchds.optim.transaction import Snapshot

Shape = tuple[int, ...]

# What torch and its schedulers write into groups beside the options.
BESIDE = {"params", "param_names", "initial_lr", "max_lr", "min_lr", "swa_lr"}


def cost_dtype(parameters: Iterable[Tensor]) -> torch.dtype:
    """The dtype of costs: that of the parameters, the widest where there are several, float32 at least."""
    return functools.reduce(torch.promote_types, [p.dtype for p in parameters], torch.float32)


def finite(value: Tensor) -> bool:
    """Whether all of `value` is finite."""
    return not value.numel() or math.isfinite(torch.linalg.vector_norm(value, math.inf).item())


class Place(NamedTuple):
    """Where an entry of the state stands: the search, its group, and the shape of the parameter."""

    search: Resumable
    group: Mapping[str, Any]
    shape: Shape


class Entry(NamedTuple):
    """A tensor that a search keeps in `state`, by parameter.

    Attributes:
        words: its shape, for messages.
        fits: whether a shape is that, at a place.
        of: whether each parameter has it, or only the first one of a group, or of the search.
        beside: the entry that is there whenever this one is.
        holds: whether its values are allowed.
    """

    words: str
    fits: Callable[[Shape, Place], bool]
    of: Literal["parameter", "group", "search"] = "parameter"
    beside: str | None = None
    holds: Callable[[Tensor], bool] = finite


NOISE = Entry("(N, *shape)", lambda shape, at: shape == (at.search.n_rollouts, *at.shape))
BEST = Entry("(*shape)", lambda shape, at: shape == at.shape, beside="best_cost")
BEST_COST = Entry(
    "(*batch)",
    lambda shape, at: shape == at.shape[: len(shape)],
    of="search",
    beside="best",
    holds=lambda value: not value.isnan().any(),
)


class Resumable(torch.optim.Optimizer):
    """Base of searches: `state_dict`, `load_state_dict`, copies and pickles."""

    entries: ClassVar[Mapping[str, Entry]] = {"noise": NOISE, "best": BEST, "best_cost": BEST_COST}
    """What may be in the state. A class that says so itself refuses all else; one that inherits this may have more."""

    n_rollouts: int
    generator: torch.Generator
    explorations: list[Exploration]
    last: Any

    @property
    def parameters(self) -> list[nn.Parameter]:
        """All parameters of all groups, in order."""
        return [p for group in self.param_groups for p in group["params"]]

    def _check_options(self, group: Mapping[str, Any]) -> None: ...

    def _check_promise(self, group: Mapping[str, Any], exploration: Exploration) -> None: ...

    def state_dict(self) -> dict[str, Any]:
        """Parameters' state and groups as in torch.optim, and the search's name, generator and explorations beside them."""
        extra = {
            "search": type(self).__name__,
            "generator": self.generator.get_state(),
            "explorations": [exploration.state_dict() for exploration in self.explorations],
        }
        return {**super().state_dict(), **extra}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Continue bit for bit where `state_dict` was taken; where it is refused, nothing changes.

        Raises:
            InvalidArgumentError: the state of another search, of other parameters or explorations, with entries missing or
                too many, or with options out of range.
        """
        if not isinstance(state_dict, Mapping):
            raise InvalidArgumentError(f"a state is what state_dict() gives, got {type(state_dict).__name__}")
        # The last of the hooks sees what the others made of it.
        handle = self.register_load_state_dict_pre_hook(_arrive)
        before = Snapshot(self)
        try:
            try:
                super().load_state_dict(dict(state_dict))
            finally:
                handle.remove()
                vars(self).pop("_arrived", None)
        except BaseException:
            before.restore()
            raise

    def __getstate__(self) -> dict[str, Any]:
        """What copies and pickles keep: all attributes but those of torch, the generator by its state."""
        own = {name: value for name, value in vars(self).items() if name not in _of_torch()}
        return {**super().__getstate__(), **own, "generator": self.generator.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if isinstance(state.get("generator"), Tensor):
            generator = torch.Generator()
            generator.set_state(state["generator"])
            state = {**state, "generator": generator}
        arrived = vars(self).get("_arrived")
        if arrived is not None:  # torch's load_state_dict comes here, with a state in the dtype of the parameters
            exact = {p: _exact(entries, p) for p, entries in _by_parameter(self, arrived["state"]).items()}
            state = {**state, "state": defaultdict(dict, exact)}
        super().__setstate__(state)
        if arrived is not None:
            self.generator.set_state(arrived["generator"].cpu())
            for exploration, values in zip(self.explorations, arrived["explorations"], strict=True):
                _restore(exploration, values)


@functools.cache
def _of_torch() -> frozenset[str]:
    """Attributes that torch and its schedulers give an optimizer: hooks and wrappers, which copies do not take along.

    Asked for when something is copied: torch's first optimizer imports its compiler.
    """
    return frozenset({*vars(torch.optim.Optimizer([{"params": []}], {})), "step"})


def _arrive(search: Any, given: dict[str, Any]) -> None:
    check_state(search, given)
    search._arrived = given


def _by_parameter(search: Resumable, state: Mapping[int, Any]) -> dict[Tensor, Any]:
    parameters = search.parameters
    return {parameters[i]: entries for i, entries in state.items()}


def _exact(value: Any, p: Tensor) -> Any:
    """A copy on the device of `p`, each tensor in its own dtype; bytes, as generators have them, stay where they are."""
    if isinstance(value, Tensor):
        return value.detach().to(value.device if value.dtype == torch.uint8 else p.device, copy=True)
    if isinstance(value, dict):
        return {name: _exact(entry, p) for name, entry in value.items()}
    return [_exact(entry, p) for entry in value] if type(value) is list else copy.deepcopy(value)


def _restore(exploration: Exploration, values: Mapping[str, Any]) -> None:
    try:
        exploration.load_state_dict(values)
    except TorchdsError:
        raise
    except Exception as error:
        raise InvalidArgumentError(
            f"this is no state of {type(exploration).__name__}: {type(error).__name__} {error}"
        ) from error


# ------------------------------------------------------------------ what a state has to be


def check_state(search: Resumable, given: Mapping[str, Any]) -> None:
    """Refuse what `search` could not continue from, before anything changes.

    Raises:
        InvalidArgumentError: what differs.
    """
    who = type(search).__name__
    if missing := [name for name in ("state", "param_groups", "generator", "explorations") if name not in given]:
        raise InvalidArgumentError(f"this is no state of {who}, {missing} are not in it; got {sorted(map(str, given))}")
    if not isinstance(of := given.get("search"), str) or of != who:
        raise InvalidArgumentError(
            f"this is a state of {shown(of)} and cannot be continued by {who}; make the optimizer that it is of"
        )
    _check_groups(search, given["param_groups"])
    _check_generator(given["generator"])
    explorations = given["explorations"]
    if not isinstance(explorations, Sequence) or len(explorations) != len(search.explorations):
        raise InvalidArgumentError(
            f"states of {len(search.explorations)} explorations are needed, got {shown(explorations)}"
        )
    for exploration, state in zip(search.explorations, explorations, strict=True):
        if not isinstance(state, Mapping):
            raise InvalidArgumentError(f"{type(exploration).__name__} needs a dict as its state, got {shown(state)}")
    n = len(search.parameters)
    state = given["state"]
    if not isinstance(state, Mapping) or not all(type(i) is int and 0 <= i < n for i in state):
        raise InvalidArgumentError(
            f"the state has to be a dict by the numbers of the {n} parameters, got {shown(state)}"
        )
    for i, entries in state.items():
        if not isinstance(entries, Mapping) or not all(isinstance(name, str) for name in entries):
            raise InvalidArgumentError(f"the state of parameter {i} has to be a dict by names, got {shown(entries)}")
    check_entries(search, _by_parameter(search, state), "; load a state of the same parameters and options")


def _check_groups(search: Resumable, groups: Any) -> None:
    if not isinstance(groups, Sequence) or len(groups) != len(search.param_groups):
        raise InvalidArgumentError(f"a state of {len(search.param_groups)} groups is needed, got {shown(groups)}")
    first = 0
    for i, (own, group, exploration) in enumerate(zip(search.param_groups, groups, search.explorations, strict=True)):
        n = len(own["params"])
        given = group.get("params") if isinstance(group, Mapping) else None
        if not isinstance(given, list) or [*map(repr, given)] != [*map(repr, range(first, first + n))]:
            raise InvalidArgumentError(
                f"group {i} has to have the parameters {first} to {first + n - 1}, got {shown(group)}; a state of as many "
                "parameters in the same groups is needed"
            )
        first += n
        names, own_names = group.get("param_names"), own.get("param_names")
        named = isinstance(names, Sequence) and len(names) == n and all(isinstance(name, str) for name in names)
        if names is not None and (not named or (own_names is not None and list(names) != list(own_names))):
            raise InvalidArgumentError(f"group {i} has the parameters {own_names or n}, got a state of {shown(names)}")
        if differing := (own.keys() ^ group.keys()) - BESIDE:
            raise InvalidArgumentError(
                f"group {i} has the options {sorted(own.keys() - BESIDE)}; the state has not, or has more: {sorted(differing)}"
            )
        search._check_options(group)
        search._check_promise(group, exploration)


def _check_generator(state: Any) -> None:
    try:
        torch.Generator().set_state(state.cpu())
    except (AttributeError, TypeError, RuntimeError) as error:
        raise InvalidArgumentError(f"this is no state of a torch.Generator: {error}") from error


def check_entries(search: Resumable, state: Mapping[Tensor, Mapping[str, Any]], instead: str) -> None:
    """Refuse a state that does not fit the parameters as they are.

    Args:
        search: that the state is for.
        state: the entries of each parameter.
        instead: what to do, in words.

    Raises:
        InvalidArgumentError: entries missing, too many, or of another shape or dtype, or values that are not allowed.
    """
    known, strict = search.entries, "entries" in vars(type(search))
    present = {name for entries in state.values() for name in entries}
    if strict and (strange := present - known.keys()):
        raise InvalidArgumentError(f"{type(search).__name__} keeps {sorted(known)}, got {sorted(strange)}{instead}")
    lengths, number = set(), 0
    for group in search.param_groups:
        for j, p in enumerate(group["params"]):
            where = {"parameter"} | ({"group"} if j == 0 else set()) | ({"search"} if number == 0 else set())
            mine = state.get(p, {})
            for name in sorted(present & known.keys()):
                entry = known[name]
                if (name in mine) != (entry.of in where) or (entry.beside is not None and entry.beside not in present):
                    raise InvalidArgumentError(
                        f"the state has {name!r} of some parameters only, or without {entry.beside!r}; parameter {number} "
                        f"has {sorted(mine)}{instead}"
                    )
                if name in mine:
                    _check_entry(name, entry, mine[name], Place(search, group, tuple(p.shape)), p, number, instead)
                    lengths |= {len(mine[name])} if entry.words.startswith("(M") else set()
            number += 1
    if len(lengths) > 1:
        raise InvalidArgumentError(
            f"what was tried has to be as long for all parameters, got {sorted(lengths)}{instead}"
        )


def _check_entry(name: str, entry: Entry, value: Any, at: Place, p: Tensor, number: int, instead: str) -> None:
    if not isinstance(value, Tensor) or not value.is_floating_point():
        raise InvalidArgumentError(f"{name!r} of parameter {number} has to be a tensor, got {shown(value)}{instead}")
    dtype = cost_dtype(at.search.parameters) if entry.of == "search" else p.dtype
    if value.dtype != dtype:
        raise InvalidArgumentError(f"{name!r} of parameter {number} has to be {dtype}, got {value.dtype}{instead}")
    if not entry.fits(tuple(value.shape), at):
        raise InvalidArgumentError(
            f"{name!r} of parameter {number} with the shape {at.shape} has to be {entry.words}, with "
            f"N = {at.search.n_rollouts}, got {tuple(value.shape)}{instead}"
        )
    if not entry.holds(value):
        raise InvalidArgumentError(
            f"{name!r} of parameter {number} has values that are not allowed, got {shown(value)}{instead}"
        )
