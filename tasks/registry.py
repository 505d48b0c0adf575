"""Tasks by name, or by the place where their class stands."""

from __future__ import annotations

import inspect
from dataclasses import fields
from typing import Any, TypeVar

from tasks.base import Task
from tasks.loading import is_problem, is_spec, load_object
from tasks.lwr_digging import DiggingOptions
from tasks.plain import required
from tasks.settings import Convention
from tasks.sketch.task import of_file
from torchds.arrays import shown
from torchds.errors import InvalidArgumentError, UnknownNameError

Class = TypeVar("Class", bound=type[Task])

TASKS: dict[str, dict[Convention, type[Task]]] = {
    DiggingOptions.name: {"paper": DiggingOptions},  # type: ignore[type-abstract] # what is made is its subclass
}
"""The classes by name and convention; the digging task is imported when it is made, since it needs its extra."""


def register(task: Class) -> Class:
    """Make a task known by its `name`: to `make` and to the training commands of this program; also a decorator.

    Raises:
        InvalidArgumentError: no class of tasks, one that is not complete, or a name that another class has.
    """
    if not (inspect.isclass(task) and issubclass(task, Task)):
        raise InvalidArgumentError(f"register takes a class of tasks, got {shown(task)}")
    if inspect.isabstract(task):
        missing = ", ".join(sorted(task.__abstractmethods__))
        raise InvalidArgumentError(f"{task.__name__} is not complete: it has to define {missing}")
    distinct(task)
    TASKS.setdefault(task.name, {})[task.convention] = task
    return task


def distinct(task: type[Task], advice: str = 'give the class another one: name = "..."') -> None:
    """Refuse a task with the name of another one; `advice` says how it gets its own.

    Raises:
        InvalidArgumentError: another class has its name.
    """
    other = TASKS.get(task.name, {}).get(task.convention)
    if other is not None and (other.__module__, other.__qualname__) != (task.__module__, task.__qualname__):
        raise InvalidArgumentError(
            f"the name {task.name!r} of {task.__qualname__} belongs to {other.__module__}.{other.__qualname__}; {advice}"
        )


def options_of(name: str) -> type[Task]:
    """The class whose fields are the options of the task `name`; for digging, one that needs no extra.

    Raises:
        UnknownNameError: no task of this name; the message lists them.
        InvalidArgumentError: `name` says where a class or a problem file stands, and there is none, or no good one.
        FileError: no such problem file, or one that cannot be read.
    """
    if is_problem(name):
        drawn = of_file(name)
        distinct(drawn, f"give the file {name} another one")
        return drawn
    if is_spec(name):
        task = load_object(name, Task)  # type: ignore[type-abstract] # a base, nothing to make
        distinct(task)
        return task
    if name not in TASKS:
        raise UnknownNameError("task", name, TASKS)
    return TASKS[name]["paper"] if "paper" in TASKS[name] else next(iter(TASKS[name].values()))


def task_class(name: str, convention: str = "paper") -> type[Task]:
    """The class of the task `name`, which may also say where one stands: "my_file.py:MyTask", "my_problem.json".

    Raises:
        UnknownNameError: no task of this name; the message lists them.
        MissingPackageError: the task needs an extra that is not installed.
        InvalidArgumentError: a convention that the task does not have, or no class where `name` says.
    """
    first = options_of(name)
    classes = {first.convention: first} if is_spec(name) else TASKS[name]
    for known, task in classes.items():
        if known == convention:
            return task if task is not DiggingOptions else _digging()
    has = " or ".join(map(repr, classes))
    raise InvalidArgumentError(f"convention of task {first.name!r} has to be {has}, got {convention!r}")


def _digging() -> type[Task]:
    from tasks.digging.task import LwrDigging

    return LwrDigging


def make(name: str, *, convention: str = "paper", **options: Any) -> Task:
    """Build the task `name` with its own options.

    Args:
        name: of a task that is registered, or where its class stands: "my_file.py:MyTask", "my_package.module:MyTask"; or that
            of a problem file: "my_problem.json".
        convention: "paper" as printed, or "released" for the problem as the authors' program runs it, where a task has it.
        **options: the fields of the task.

    Raises:
        UnknownNameError: no task of this name; the message lists them.
        MissingPackageError: the task needs an extra that is not installed.
        InvalidArgumentError: an option that the task does not have, or one that is missing, or a value that it does not allow.
    """
    cls = task_class(name, convention)
    names = [field.name for field in fields(cls) if field.init]
    shared = [field.name for field in fields(Task) if field.init]
    allowed = [*(name for name in names if name not in shared), *shared]  # what is its own first
    if strangers := sorted(set(options) - set(allowed)):
        has = ", ".join([*allowed, "convention"])
        raise InvalidArgumentError(f"task {name!r} has no option {', '.join(strangers)}; it has {has}")
    if missing := [name for name in required(cls) if name not in options]:
        raise InvalidArgumentError(
            f"task {name!r} needs {', '.join(missing)}, which has no default: say it, or give it one"
        )
    return cls(**options)
