"""What stands anywhere: classes, `my_file.py:Name` and `my_package.module:Name`, and problem files, `my_problem.json`."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import inspect
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from torchds.errors import InvalidArgumentError, UnknownNameError

T = TypeVar("T")


def is_spec(name: str) -> bool:
    """Whether `name` says where something stands: it has a colon, or is that of a problem file."""
    return ":" in name or is_problem(name)


def is_problem(name: str) -> bool:
    """Whether `name` is that of a problem file (`tasks.sketch`), whose class is made from it."""
    return name.endswith(".json")


def absolute(spec: str) -> str:
    """The same with the whole path of a file, so that it holds in other folders too."""
    if is_problem(spec):
        return str(Path(spec).expanduser().resolve())
    where, _, name = spec.rpartition(":")
    return f"{Path(where).expanduser().resolve()}:{name}" if where.endswith(".py") else spec


def short(spec: str) -> str:
    """The name of the class or of the problem alone, for folders and tables; other names stay what they are."""
    if is_problem(spec):
        return re.sub(r"\W+", "_", Path(spec).stem).strip("_").lower() or "problem"
    return spec.rpartition(":")[2]


def file_of(spec: str) -> Path | None:
    """The file that `spec` names; None for other names."""
    where = spec if is_problem(spec) else spec.rpartition(":")[0]
    return Path(where) if is_problem(spec) or where.endswith(".py") else None


def bare(value: Any) -> Any:
    """The place of a class or a problem without the folder of its file; anything else as it is."""
    return Path(value).name if isinstance(value, str) and file_of(value) is not None else value


def helpers(file: Path) -> list[Path]:
    """The files beside `file` that it imports, also through one another."""
    found, left = {file}, [file]
    while left:
        try:
            tree = ast.parse(left.pop().read_bytes())
        except (SyntaxError, ValueError):  # which importing it explains
            continue
        for node in ast.walk(tree):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            beside = {file.with_name(f"{name.partition('.')[0]}.py") for name in names} - found
            found |= (new := {path for path in beside if path.is_file()})
            left += new
    return sorted(found - {file})


def told_apart(specs: Iterable[str], brief: Callable[[str], str] = short) -> dict[str, str]:
    """What a table calls each of several things that stand anywhere: short, or whole where two of them have one short name.

    Args:
        specs: where they stand, or their names; a place may be said in several ways.
        brief: makes the short name.
    """
    whole = {spec: absolute(spec) for spec in specs}
    briefs = Counter(brief(spec) for spec in set(whole.values()))
    return {spec: brief(place) if briefs[brief(place)] == 1 else place for spec, place in whole.items()}


def load_object(spec: str, base: type[T]) -> type[T]:
    """The class that `spec` names.

    Args:
        spec: "my_file.py:Name", the path absolute or as seen from here, or "my_package.module:Name".
        base: what it has to be a subclass of.

    Raises:
        InvalidArgumentError: no such file or module, an error while it is imported, or something else than a subclass of
            `base`.
        UnknownNameError: the file has no such name; the message lists the subclasses of `base` that it has.
    """
    where, _, name = spec.rpartition(":")
    if not where or not name:
        raise InvalidArgumentError(f"the place of a class has to be FILE.py:NAME or PACKAGE.MODULE:NAME, got {spec!r}")
    module = _from_file(Path(where)) if where.endswith(".py") else _from_module(where, spec)
    found = getattr(module, name, None)
    if found is None:
        known = [n for n, value in vars(module).items() if _fits(value, base) and value.__module__ == module.__name__]
        raise UnknownNameError(f"{base.__name__} in {where}", name, known)
    if not _fits(found, base):
        raise InvalidArgumentError(
            f"{spec!r} has to be a subclass of {base.__module__}.{base.__qualname__}, got {found!r}"
        )
    if inspect.isabstract(found):
        missing = ", ".join(sorted(found.__abstractmethods__))
        raise InvalidArgumentError(f"{spec!r} is not complete: it has to define {missing}")
    return found


def _fits(value: object, base: type) -> bool:
    return inspect.isclass(value) and issubclass(value, base)


_folders: set[Path] = set()  # of the files that were imported


def _from_file(file: Path) -> ModuleType:
    """The module in a file, imported once; files beside it can be imported from it.

    Python knows one module of each name: what stands beside it may not be called as what was imported from beside another one.
    """
    path = file.expanduser().resolve()
    if not path.is_file():
        raise InvalidArgumentError(f"no file {path}; give the path of a Python file, then :NAME")
    name = f"{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    for beside in helpers(path):
        known = Path(getattr(sys.modules.get(beside.stem), "__file__", None) or beside)
        if known.parent in _folders and not (known.is_file() and known.read_bytes() == beside.read_bytes()):
            raise InvalidArgumentError(
                f"{beside.stem} is known from {known}, so that {path} cannot import {beside}; rename one of them"
            )
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    folder = str(path.parent)
    _folders.add(path.parent)
    sys.path.insert(0, folder)  # what stands beside it comes before what another folder calls the same
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise InvalidArgumentError(f"{path} cannot be imported: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(folder)
        if folder not in sys.path:
            sys.path.append(folder)
    return module


def _from_module(where: str, spec: str) -> ModuleType:
    """The module of this name, imported."""
    try:
        return importlib.import_module(where)
    except Exception as error:
        raise InvalidArgumentError(
            f"{spec!r}: module {where} cannot be imported: {type(error).__name__}: {error}; looked for it from {Path.cwd()} "
            "and in the installed packages"
        ) from error
