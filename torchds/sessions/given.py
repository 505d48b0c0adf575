"""The references that a session gave out: whose they are, and that nobody replaces or changes them.

`asked.json` stands beside them with the id that the session's state has, and a digest of each: it is written last, so that a
folder without it was not finished.

Stability: experimental.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from torchds.errors import FileError, InvalidArgumentError
from torchds.files import digest, make_folder, read_sealed, reason, write_sealed, write_text
from torchds.sessions.tables import COSTS

STATE, ASKED = "session.pt", "asked.json"
RUN = ("options.json", "checkpoint.pt")  # what the folder of a training run has


def refuse_used(folder: Path, next: str) -> None:
    """Refuse a folder that is in use already.

    Args:
        folder: of a session to begin.
        next: what to do where a session is there already.

    Raises:
        InvalidArgumentError: a session is there, or a run.
    """
    if (folder / STATE).exists() or list(folder.glob("update-*")):
        raise InvalidArgumentError(f"{folder} holds a session already; {next}")
    if any((folder / name).exists() for name in RUN):
        raise InvalidArgumentError(f"{folder} holds a run; give another folder for the session")


def give(folder: Path, id: str, texts: Mapping[str, str]) -> None:
    """Write references by name into the folder of an update; those that are there stay.

    Args:
        folder: of the update; it is made.
        id: of what was asked.
        texts: content of each file, by name.

    Raises:
        FileError: another session or another process gave out something else here, a file was changed, or the folder was used
            before; nothing is replaced.
    """
    if folder.is_symlink():
        raise FileError(f"{folder} is a link; a session writes into folders of its own. Remove the link")
    make_folder(folder)
    if (folder / ASKED).is_file():
        return _give_again(folder, id, texts)
    if early := sorted(
        path.name
        for path in folder.iterdir()
        if path.name == COSTS or (path.suffix == ".csv" and path.name.startswith("recording-"))
    ):
        raise FileError(f"{folder} has {', '.join(early)} before anything was asked; move them away")
    for name, text in texts.items():
        path = folder / name
        if not os.path.lexists(path):
            write_text(path, text)
        elif read(path) != text and not name.endswith(".failed"):
            raise FileError(
                f"{path} is there and is not what this session gives out; nothing is replaced. Move it away, and ask again"
            )
    _sign(folder, id, texts, {})


def _give_again(folder: Path, id: str, texts: Mapping[str, str]) -> None:
    """Write what is gone of what was given out, with the last digits of this processor and these versions."""
    given = check_given(folder, id)
    gone = {name: text for name, text in texts.items() if name in given and not os.path.lexists(folder / name)}
    if any(digest(text) != given[name] for name, text in gone.items()):
        _sign(folder, id, gone, given)  # before they are there: a kill leaves files that are given out once more
    for name, text in gone.items():
        write_text(folder / name, text)


def _sign(folder: Path, id: str, texts: Mapping[str, str], given: Mapping[str, str]) -> None:
    """Write whose references these are, with their digests and those that were `given` before."""
    references = {**given, **{name: digest(text) for name, text in texts.items()}}
    write_sealed(folder / ASKED, {"id": id, "references": references})


def check_given(folder: Path, id: str) -> dict[str, str]:
    """The digests of what the session gave out, by name; a folder that holds anything else is refused.

    Raises:
        FileError: they are of another session, were changed, or were not all written.
    """
    path = folder / ASKED
    if not path.is_file():
        raise FileError(f"{folder}: the references are not all there; ask again")
    content = read_sealed(path)
    if content.get("id") != id:
        raise FileError(
            f"{folder} has references that this session did not give out; it is at {id}, they are {content.get('id')}"
        )
    references: dict[str, str] = content["references"]
    for name, written in references.items():
        if name.endswith(".csv") and os.path.lexists(folder / name) and digest(read(folder / name)) != written:
            raise FileError(f"{folder / name} was changed since it was given out; move it away, and ask again")
    return references


def read(path: Path) -> str:
    """The text of a file that is no link.

    Raises:
        FileError: it is one, or cannot be read.
    """
    if path.is_symlink() or not path.is_file():
        raise FileError(f"{path} is a link, or no file; nothing is written there. Remove it, and ask again")
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise FileError(f"{path} cannot be read: {reason(error)}") from error
