"""Learning to dig with a robot: `python -m train hardware start | ask | tell | status DIR`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from tasks.settings import Convention
from train.options import options_class

if TYPE_CHECKING:
    from train.hardware.session import Session


DiggingOptions: Any = options_class("lwr_digging")


@dataclass
class SessionOptions(DiggingOptions):
    """The options of the training command, without those that a robot decides by itself or has no use for."""

    runs: tyro.conf.Fixed[int] = 1
    elite: tyro.conf.Fixed[Literal["none", "nominal", "best"] | None] = "nominal"
    cost_noise: tyro.conf.Fixed[float] = 0.0
    learn: tyro.conf.Fixed[Literal["both", "motion", "stiffness"]] = "both"
    grains: tyro.conf.Fixed[Literal["fine", "coarse"]] = "fine"
    threads: tyro.conf.Fixed[int] = 1
    convention: tyro.conf.Fixed[Convention] = "paper"
    logdir: tyro.conf.Fixed[Path] = field(default_factory=lambda: Path("logs"))
    resume: tyro.conf.Fixed[Path | None] = None


@dataclass
class Start:
    """Begin a session in a new folder."""

    folder: tyro.conf.Positional[Path]
    """Where the session keeps its files; it is made."""
    options: tyro.conf.OmitArgPrefixes[tyro.conf.SuppressFixed[SessionOptions]] = field(default_factory=SessionOptions)

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
        from train.hardware.session import Session  # needs MuJoCo, as only the digging task does

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
class Hardware:
    """Learn to dig with a robot, through files: see docs/hardware.md."""

    command: tyro.conf.OmitSubcommandPrefixes[
        Annotated[Start, tyro.conf.subcommand("start")]
        | Annotated[Ask, tyro.conf.subcommand("ask")]
        | Annotated[Tell, tyro.conf.subcommand("tell")]
        | Annotated[Status, tyro.conf.subcommand("status")]
    ]

    def main(self) -> None:
        """Do what the subcommand says."""
        self.command.main()
