"""Archives of arrays that numpy alone reads, and what is checked of a file before it is read.

`torchds.files.save` writes an archive for torch. Beside torch's own members it can hold an index in JSON: the content with,
in place of each tensor, the member that holds its bytes. So one file serves torch and a computer that has no torch. Nothing
in it can run code.

Stability: experimental.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import secrets
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from torchds.errors import FileError

SEAL = "torchds"
FORMAT = 1  # of the index; a file of a later one is refused
PLACE = "array"  # what stands for an array in the content, with its number
INDEX = "without_torch.json"
EMPTY = 22  # bytes of an archive of nothing
LARGEST = 2**31  # bytes that one archive may unpack to


def add_index(buffer: io.BytesIO, kind: str, content: str, arrays: Sequence[np.ndarray]) -> None:
    """Add an index to the archive that torch has written.

    Args:
        buffer: the archive.
        kind: what the content is, such as "policy".
        content: JSON, with {PLACE: i} for arrays[i].
        arrays: the bytes of each are a member of the archive.
    """
    with zipfile.ZipFile(buffer, "a") as archive:
        names = archive.namelist()
        members = {
            archive.read(name): name for name in names
        }  # found by content: how torch counts them is its own affair
        places = [[members[array.tobytes()], array.dtype.str, array.shape] for array in arrays]
        index = {
            SEAL: FORMAT,
            "kind": kind,
            "arrays": places,
            "digest": _digest(kind, content, arrays),
            "content": content,
        }
        archive.writestr(f"{names[0].split('/')[0]}/{INDEX}", json.dumps(index))


def read(path: str | Path, kind: str) -> dict[str, Any]:
    """The content of a file by its index, verified, with arrays where tensors are; torch is not needed.

    Raises:
        FileError: there is no such file, it is damaged, of another kind, of a later version, or has no index.
    """
    path = existing(path)
    try:
        with zipfile.ZipFile(path) as archive:
            check_sizes(path, archive, stored=True)
            members = [name for name in archive.namelist() if name.endswith(f"/{INDEX}")]
            index = json.loads(archive.read(members[0])) if members else {}
            if index.get(SEAL) == FORMAT and index["kind"] == kind:
                arrays = [_array(archive.read(member), *form) for member, *form in index["arrays"]]
                if _digest(kind, index["content"], arrays) != index["digest"]:
                    raise FileError(f"{path} is damaged: its content does not have the digest that was written with it")
                content: dict[str, Any] = json.loads(
                    index["content"], object_hook=lambda item: arrays[item[PLACE]] if list(item) == [PLACE] else item
                )
                return content
    except FileError:
        raise
    except Exception as error:  # zipfile, json and numpy raise many kinds
        raise FileError(
            f"{path} is no readable file of a {kind}: it is damaged, cut, or another kind of file"
        ) from error
    if not members:
        raise FileError(f"{path} cannot be read without torch: it was not written as a {kind} by this version")
    if index.get("kind") != kind:
        raise FileError(f"{path} is a {index.get('kind')}, needed is a {kind}")
    raise FileError(f"{path} has format {index.get(SEAL)}, this version reads up to {FORMAT}; install a newer torchds")


def _array(data: bytes, dtype: str, shape: Sequence[int]) -> np.ndarray:
    return np.frombuffer(data, np.dtype(dtype)).reshape(shape)


def _digest(kind: str, content: str, arrays: Sequence[np.ndarray]) -> str:
    """SHA-256 of all that an index says and points to."""
    sha = hashlib.sha256(json.dumps([kind, content, [[a.dtype.str, a.shape] for a in arrays]]).encode())
    for array in arrays:
        sha.update(array.tobytes())
    return sha.hexdigest()


# ------------------------------------------------------------------ before a file is read


def existing(path: str | Path) -> Path:
    """The path of a regular file that is there.

    Raises:
        FileError: there is none, or it is a folder or something else.
    """
    path = Path(path)
    try:
        if path.is_file():
            return path
        there = path.exists()
    except (OSError, ValueError) as error:  # a name that is too long, or has a null in it
        raise FileError(f"{str(path)!r} is no usable name of a file: {reason(error)}") from error
    if there:
        raise FileError(f"{path} is a folder or something else that is no file")
    raise FileError(f"{path}: no such file (looked in {path.parent.resolve()})")


def reason(error: BaseException) -> str:
    """What the system says about a file, without the path."""
    return getattr(error, "strerror", None) or str(error).split("\n")[0] or type(error).__name__


def check_sizes(path: Path, archive: zipfile.ZipFile, *, stored: bool) -> None:
    """Refuse an archive that would unpack to more than it can be meant to hold, or that lost a member."""
    size = path.stat().st_size
    unpacked = sum(member.file_size for member in archive.infolist())
    allowed = size if stored else min(LARGEST, max(100 * size, 2**28))
    if unpacked > allowed:
        raise FileError(f"{path} has {size} bytes and claims to unpack to {unpacked}; at most {allowed} are taken")
    names = [member.filename for member in archive.infolist()]
    if len(set(names)) < len(names):
        raise FileError(f"{path} holds several members of one name")
    if not names and size > EMPTY:
        raise FileError(f"{path} is damaged: its directory names none of what its {size} bytes hold")
    if (said := _members_said(path)) not in (None, len(names)):
        raise FileError(f"{path} is damaged: its directory has {len(names)} members where its end says {said}")


def _members_said(path: Path) -> int | None:
    """How many members the end of an archive says it has, which zipfile does not look at; None where it does not say."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - 2**16 - 22, 0))
        tail = file.read()
    at = tail.rfind(b"PK\x05\x06")
    count = int.from_bytes(tail[at + 10 : at + 12], "little") if 0 <= at <= len(tail) - 22 else 0xFFFF
    return None if count == 0xFFFF else count  # so many, or written elsewhere


def write_atomically(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Call `write(stream)`, then move what it wrote into place: the old file stays until the new one is whole.

    Args:
        path: of the file; a link is replaced, not followed.
        write: puts the content into an empty file that belongs to this call alone.

    Raises:
        FileError: the disk is full, read-only or gone; nothing has changed.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(6)}.part")
    try:
        handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        try:
            with os.fdopen(handle, "wb") as stream:
                write(stream)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        _flush_folder(path.parent)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {reason(error)}; what was there before is unchanged") from error


def _flush_folder(path: Path) -> None:
    """Have the system write the entries of a folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
