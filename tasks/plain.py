"""Values of fields and options as JSON has them, and back: what one of a type can look like there, and what that says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

UNREAL = ("inf", "-inf", "nan")  # numbers that JSON does not have


def plain(value: Any) -> Any:
    """The value as JSON gives it back: a path as its text, a tuple as a list, a number that is not finite by its name."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) or (isinstance(value, float) and not math.isfinite(value)) else value


def restored(value: Any, kind: Any) -> Any:
    """What `plain` was given, of a value that `fits` this type; one that is of the type already stays what it is."""
    if get_origin(kind) in (Union, UnionType):
        return next((restored(value, each) for each in get_args(kind) if fits(value, each)), value)
    if (kinds := entries(value, kind)) is not None:
        parts = [restored(part, each) for part, each in zip(value, kinds, strict=True)]
        return tuple(parts) if tuple in (kind, get_origin(kind)) else parts
    return kind(value) if kind in (float, Path) and isinstance(value, str) else value


def fits(value: Any, kind: Any) -> bool:
    """Whether a plain value can be one of an option of this type."""
    origin, named = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(fits(value, each) for each in named)
    if origin is Literal:
        return any(value == each and type(value) is type(each) for each in named)
    if list in (kind, origin) or tuple in (kind, origin):
        kinds = entries(value, kind)
        return kinds is not None and all(fits(part, each) for part, each in zip(value, kinds, strict=True))
    if kind is float and isinstance(value, str):
        return value in UNREAL
    known: dict[Any, Any] = {bool: bool, int: int, float: (int, float), str: str, Path: (str, Path), NoneType: NoneType}
    return kind not in known or (isinstance(value, known[kind]) and (kind is bool or not isinstance(value, bool)))


def entries(value: Any, kind: Any) -> list[Any] | None:
    """The types of the entries of a value, as a list or a tuple of this type has them; None where it cannot be one."""
    origin, named = get_origin(kind) or kind, get_args(kind)
    if origin not in (list, tuple) or not isinstance(value, (list, tuple)):
        return None
    if origin is tuple and named and named[-1] is not Ellipsis:
        return list(named) if len(named) == len(value) else None
    return [named[0] if named else Any] * len(value)


def required(cls: Any) -> list[str]:
    """The fields of a dataclass that have no value if nothing is said."""
    return [f.name for f in fields(cls) if f.init and f.default is MISSING and f.default_factory is MISSING]


def words(kind: Any) -> str:
    """What an option of this type can be, in words."""
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(map(words, get_args(kind)))
    if get_origin(kind) is Literal:
        return " or ".join(map(repr, get_args(kind)))
    return {NoneType: "nothing", int: "a whole number", float: "a number", str: "a text", Path: "a path"}.get(
        kind, str(kind)
    )
