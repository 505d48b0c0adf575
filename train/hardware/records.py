"""What a session with a robot says, with the commands to type."""

from __future__ import annotations

import shlex
from pathlib import Path

from torchds.sessions import records
from torchds.sessions.records import Asked as Asked
from torchds.sessions.records import Told as Told


class Status(records.Status):
    """Where a session stands, with the command to type next."""

    @staticmethod
    def hint(command: str, folder: Path) -> str:
        """A command to type."""
        if command == "insist":
            return f"{hint('tell', folder)} --force True"
        file = " best.pt" if command == "export" else ""
        return f"python -m train hardware {command} {shlex.quote(str(folder))}{file}"


hint = Status.hint
