"""Learning with a robot: `python -m train hardware start | ask | tell | status | export DIR`."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_type_hints

import tyro

from train.options import options_class

if TYPE_CHECKING:
    from train.hardware.session import Session


CONF: Any = tyro.conf  # its marks stand around types that are made here
DECIDED = {
    "runs": 1,
    "elite": "nominal",
    "cost_noise": 0.0,
    "learn": "both",
    "grains": "fine",
    "threads": 1,
    "convention": "paper",
    "logdir": Path("logs"),
    "resume": None,
    "folder": None,
    "patience": 1800.0,
}
"""Options that a robot decides by itself or has no use for."""


@cache
def session_options(task: str) -> Any:
    """The options of the training command of a task, without those that a robot decides."""
    base = options_class(task)
    kinds = get_type_hints(base, include_extras=True)
    decided = [each.name for each in fields(base) if each.name in DECIDED]
    return make_dataclass(
        "SessionOptions",
        [(name, CONF.Fixed[kinds[name]], field(default=DECIDED[name])) for name in decided],
        bases=(base,),
        kw_only=True,
    )


SessionOptions: Any = session_options("lwr_digging")


class Start:
    """Begin a session in a new folder; --task NAME for another task than the digging, with its own options."""

    folder: Path
    options: Any

    def main(self) -> None:
        """Begin, and say what comes next."""
        from train.hardware.session import Session  # as in `InSession`

        print(Session.start(self.folder, self.options).status())


@dataclass
class InSession:
    """A command to a session that is there."""

    folder: tyro.conf.Positional[Path]
    """The folder that `start` made."""

    def session(self) -> Session:
        """The session, as it was left."""
        from train.hardware.session import Session  # imports much

        return Session.open(self.folder)


@dataclass
class Ask(InSession):
    """Write the roll-outs to execute; the same ones until they are told."""

    def main(self) -> None:
        """Ask, and say what to do."""
        session = self.session()
        print(session.ask())
        print(session.status().next)


@dataclass
class Tell(InSession):
    """Make the update from the recordings or costs that lie beside the roll-outs."""

    missing: Literal["wait", "failed"] = "wait"
    """What to do about roll-outs that have not come back. wait: make no update before they are there. failed: count them as
    failed."""
    force: bool = False
    """Take recordings that do not look like the motions that were asked for."""

    def main(self) -> None:
        """Tell, and say what happened."""
        session = self.session()
        told, status = session.tell(self.missing, self.force), session.status()
        before = f"update {status.done} has been told already" if status.done else "nothing has been asked yet"
        print(f"{before}; nothing is changed" if told is None else told)
        print(status.next)


@dataclass
class Status(InSession):
    """Say where a session stands, what it has cost so far, and what comes next."""

    def main(self) -> None:
        """Look, and change nothing."""
        print(self.session().status())


@dataclass
class Export(InSession):
    """Write the best policy for a controller: the one that cost least of those that were tried without noise."""

    file: tyro.conf.Positional[Path]
    """What is written, for `torchds.Controller.load`."""
    dt: float | None = None
    """Time step of the controller [s]; that of the trials by default."""

    def main(self) -> None:
        """Write, and say what."""
        session = self.session()
        dt = session.trial.dt if self.dt is None else self.dt
        session.export(self.file, dt=dt)
        assert session.best is not None  # or nothing was exported
        cost = session.best[1]
        update = session.history.cost.index([cost]) + 1
        print(
            f"{self.file}: the policy that cost {cost:.4g} when update {update} tried it, for a time step of {dt:g} s"
        )


class Hardware:
    """Learn with a robot, through files: see docs/hardware.md."""

    command: Any

    def main(self) -> None:
        """Do what the subcommand says."""
        self.command.main()


def hardware(arguments: list[str]) -> Any:
    """The command for the task that `--task` names, which is taken out of the arguments; the digging by default."""
    task = "lwr_digging"
    if "--task" in arguments[:-1]:
        i = arguments.index("--task")
        task = arguments[i + 1]
        del arguments[i : i + 2]
    options = session_options(task)
    shown: Any = CONF.OmitArgPrefixes[CONF.SuppressFixed[options]]
    folder: Any = Annotated[
        tyro.conf.Positional[Path], tyro.conf.arg(help="Where the session keeps its files; it is made.")
    ]
    start = make_dataclass(
        "Start", [("folder", folder), ("options", shown, field(default_factory=options))], bases=(Start,)
    )
    start.__doc__ = Start.__doc__
    kinds = {"start": start, "ask": Ask, "tell": Tell, "status": Status, "export": Export}
    union: Any = Union[tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in kinds.items())]  # noqa: UP007
    made = make_dataclass("Hardware", [("command", CONF.OmitSubcommandPrefixes[union])], bases=(Hardware,))
    made.__doc__ = Hardware.__doc__
    return made
