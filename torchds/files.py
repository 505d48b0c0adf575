"""Files that are whole or not there, and that are verified when they are read.

A file is written beside its place under a name of its own, flushed to the disk, and moved there: readers see the old one or
the new one. What is read back is compared with the digest that was written, since neither zip nor torch notices most
damaged bits. Nothing that is read can run code, and what it claims to be is checked before memory is taken for it.

Stability: stable.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import pickle
import struct
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchds import archives
from torchds.archives import check_sizes
from torchds.archives import existing as existing
from torchds.archives import reason as reason
from torchds.archives import write_atomically as write_atomically
from torchds.errors import FileError

FORMAT = 1  # of the envelope below; a file of a later one is refused
SEAL = archives.SEAL


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    write_atomically(path, lambda stream: stream.write(text.encode()))


def make_folder(path: Path) -> None:
    """Make a folder and those above it.

    Raises:
        FileError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"the folder {path} cannot be made: {reason(error)}; give another one") from error


# ------------------------------------------------------------------ tensors and plain values


def save(path: str | Path, kind: str, content: Mapping[str, Any], *, without_torch: bool = False) -> None:
    """Write tensors and plain values, with what they are and a digest; `torch.load(path, weights_only=True)` opens it too.

    Args:
        path: of the file.
        kind: what the content is, such as "checkpoint".
        content: dicts, lists and tuples of tensors, strings, numbers, booleans and None.
        without_torch: whether `torchds.archives.read` shall read the file too; names are strings then, tuples become lists.

    Raises:
        FileError: see `write_atomically`.
    """
    buffer = io.BytesIO()  # torch's own writer reports a full disk in words of its own
    torch.save({SEAL: FORMAT, "kind": kind, "digest": digest(content), "content": content}, buffer)
    if without_torch:
        arrays: list[np.ndarray] = []

        def place(tensor: Tensor) -> dict[str, int]:
            arrays.append(tensor.detach().cpu().contiguous().numpy())
            return {archives.PLACE: len(arrays) - 1}

        archives.add_index(buffer, kind, json.dumps(content, default=place), arrays)
    write_atomically(path, lambda stream: stream.write(buffer.getbuffer()))


def load(path: str | Path, kind: str) -> dict[str, Any]:
    """The content of a file that `save` wrote, verified; tensors come to the CPU.

    Raises:
        FileError: there is no such file, it is damaged or cut, of another kind, of a later version, or not of this library.
    """
    path = existing(path)
    try:
        with zipfile.ZipFile(path) as archive:
            check_sizes(path, archive, stored=True)
        sealed = torch.load(path, weights_only=True, map_location="cpu")
    except FileError:
        raise
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, pickle.UnpicklingError) as error:
        raise FileError(
            f"{path} is no readable file of a {kind}: it is damaged, cut, or another kind of file"
        ) from error
    except (
        Exception
    ) as error:  # the unpickler of torch lets IndexError, AttributeError and others of damaged files through
        raise FileError(f"{path} is no readable file of a {kind} ({type(error).__name__})") from error
    if not isinstance(sealed, dict) or not isinstance(sealed.get(SEAL), int):
        raise FileError(f"{path} was not written by this library, or by a version before files were verified")
    if sealed[SEAL] > FORMAT:
        raise FileError(f"{path} has format {sealed[SEAL]}, this version reads up to {FORMAT}; install a newer torchds")
    if sealed.get("kind") != kind:
        raise FileError(f"{path} is a {sealed.get('kind')}, needed is a {kind}")
    content = sealed.get("content")
    if not isinstance(content, dict) or digest(content) != sealed.get("digest"):
        raise FileError(f"{path} is damaged: its content does not have the digest that was written with it")
    return content


def digest(content: Any) -> str:
    """SHA-256 of tensors and plain values, in the order in which they stand.

    Raises:
        FileError: a value of another type, or a tensor that claims more numbers than it has.
    """
    sha = hashlib.sha256()
    for part in _parts(content):
        sha.update(part)
    return sha.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    """A value as bytes; the length of each part is said first, so that no two values look alike."""
    if isinstance(value, Tensor):
        if value.numel() * value.element_size() > value.untyped_storage().nbytes():
            raise FileError(f"a tensor of shape {tuple(value.shape)} claims more numbers than are there")
        yield f"tensor {value.dtype} {tuple(value.shape)} ".encode()
        yield value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()
    elif isinstance(value, Mapping):
        yield f"dict {len(value)} ".encode()
        for key, item in value.items():
            yield from _parts(key)
            yield from _parts(item)
    elif isinstance(value, (list, tuple)):
        yield f"{'list' if isinstance(value, list) else 'tuple'} {len(value)} ".encode()
        for item in value:
            yield from _parts(item)
    elif isinstance(value, float):
        yield b"float " + struct.pack("<d", value)
    elif isinstance(value, (str, bytes)):
        text = value.encode() if isinstance(value, str) else value
        yield f"{type(value).__name__} {len(text)} ".encode() + text
    elif value is None or isinstance(value, (bool, int)):
        yield f"{value!r} ".encode()
    else:
        raise FileError(f"a file holds tensors and plain values, not {type(value).__name__}")


# ------------------------------------------------------------------ JSON


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write plain values as JSON; NaN and infinities, which JSON does not have, become null.

    Raises:
        FileError: see `write_atomically`.
    """
    text = json.dumps(plain(content), indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


def plain(value: Any) -> Any:
    """The value with null for every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_json(path: str | Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        FileError: there is no such file, or it is not JSON with an object at its top.
    """
    path = existing(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{path} is not readable JSON: {reason(error)}") from error
    if not isinstance(content, dict):
        raise FileError(f"{path} holds a {type(content).__name__}, needed is an object with names")
    return content


def write_sealed(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write JSON with a digest of its content; what is not finite becomes null.

    Raises:
        FileError: see `write_atomically`.
    """
    content = json.loads(json.dumps(plain(content)))
    write_json(path, {**content, "digest": digest(content)})


def read_sealed(path: str | Path, unsealed: Iterable[str] = ()) -> dict[str, Any]:
    """The content of what `write_sealed` wrote, without the digest.

    Args:
        path: of the file.
        unsealed: names in a file of a version that wrote no digests; one that has no others is read as it is.

    Raises:
        FileError: there is no such file, it is damaged, or it was changed by hand.
    """
    content = read_json(path)
    written = content.pop("digest", None)
    if (written is not None or not content.keys() <= set(unsealed)) and written != digest(content):
        raise FileError(
            f"{path} is damaged, or was changed by hand: its content does not have the digest that was written with it"
        )
    return content


# ------------------------------------------------------------------ arrays


def read_npz(path: str | Path, wanted: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """The arrays of a NumPy archive by name; the sizes that it claims are checked before anything is unpacked.

    Args:
        path: of the file.
        wanted: names that are read where they are there; None for all.

    Raises:
        FileError: there is no such file, it is no such archive, is damaged, holds Python objects, or is too large.
    """
    path = existing(path)
    try:
        with zipfile.ZipFile(path) as archive:
            check_sizes(path, archive, stored=False)
            if (bad := archive.testzip()) is not None:
                raise FileError(f"{path} is damaged: {bad} does not have the checksum that was written with it")
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            names = set(arrays.files) if wanted is None else set(wanted)
            found = {name: arrays[name] for name in arrays.files if name in names}
        for name, value in found.items():
            if not isinstance(value, np.ndarray):  # numpy hands out the bytes
                raise FileError(f"{path} is damaged, or no .npz archive: {name} in it is no array")
        return found
    except FileError:
        raise
    except zipfile.BadZipFile as error:
        raise FileError(
            f"{path} is no .npz archive, or a damaged one; write one with save_npz() or numpy.savez"
        ) from error
    except Exception as error:  # numpy, zipfile and zlib raise many kinds
        raise FileError(f"{path} is no readable .npz archive: {reason(error)}") from error


def write_npz(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a NumPy archive that `read_npz` reads back exactly.

    Raises:
        FileError: see `write_atomically`.
    """
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # numpy's stub lets allow_pickle clash with every keyword
    write_atomically(path, lambda stream: stream.write(buffer.getbuffer()))
