"""Runs as data frames.

Stability: stable.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchds.errors import FileError, MissingPackageError
from torchds.files import read_sealed

if TYPE_CHECKING:
    from pandas import DataFrame

RESULTS, EVENTS = "results.json", "events.out.tfevents.*"


def to_dataframe(folder: str | Path) -> DataFrame:
    """What a run has cost, one row for each update and run of its batch.

    Args:
        folder: of a finished run of `python -m train`, which has a results.json; or of one that `TensorBoard` wrote.

    Returns:
        Columns `update`, `run`, `rollouts`, `cost`, and `cost/<name>` for each of its terms; costs that were not finite are
        NaN. From TensorBoard's file a row for each step, which is the index `rollouts`, and a column for each tag.

    Raises:
        MissingPackageError: pandas is not installed.
        FileError: there is neither file, or it is damaged; where TensorBoard's ends in the middle of a record, as while it is
            written, that is left out.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingPackageError("pandas", "monitor", "a data frame") from error
    folder = Path(folder)
    if (folder / RESULTS).is_file():
        return pandas.DataFrame(_by_run(read_sealed(folder / RESULTS, unsealed=("rollouts", "cost", "terms"))))
    if not any(folder.glob(EVENTS)):
        raise FileError(
            f"{folder} has no {RESULTS} and no events; give the folder of a finished run, or of TensorBoard's file"
        )
    frame = pandas.DataFrame(_by_tag(folder))
    return frame.rename_axis("rollouts").sort_index()


def _by_run(content: dict[str, Any]) -> dict[str, list[Any]]:
    """Columns, row by row of `[U+1][runs]` costs."""
    cost, rollouts = content["cost"], content["rollouts"]
    places = [(update, run) for update, row in enumerate(cost) for run in range(len(row))]
    columns: dict[str, list[Any]] = {
        "update": [update for update, _ in places],
        "run": [run for _, run in places],
        "rollouts": [rollouts[update] for update, _ in places],
    }
    for name, table in {"cost": cost, **{f"cost/{name}": table for name, table in content["terms"].items()}}.items():
        columns[name] = [float("nan") if table[u][r] is None else table[u][r] for u, r in places]
    return columns


def _by_tag(folder: Path) -> dict[str, dict[int, float]]:
    """Tag -> step -> number."""
    try:
        from tensorboard.compat.proto.event_pb2 import Event
    except ImportError as error:
        raise MissingPackageError("tensorboard", "monitor", "reading TensorBoard's file") from error
    found: dict[str, dict[int, float]] = {}
    for path in sorted(folder.glob(EVENTS)):
        for event in map(Event.FromString, _records(path)):
            for value in event.summary.value:
                if value.HasField("simple_value"):
                    found.setdefault(value.tag, {})[event.step] = value.simple_value
    return found


def _records(path: Path) -> Iterator[bytes]:
    """What stands in TensorBoard's file between lengths and checksums; its own readers end at a damaged one, without a word."""
    from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import masked_crc32c

    content, at = path.read_bytes(), 0

    def checked(begin: int, end: int) -> bytes:
        if struct.unpack_from("<I", content, end)[0] != masked_crc32c(content[begin:end]):
            raise FileError(
                f"{path} is damaged: its content at byte {begin} does not have the checksum that was written with it"
            )
        return content[begin:end]

    while at + 12 <= len(content):
        (length,) = struct.unpack("<Q", checked(at, at + 8))
        begin, end = at + 12, at + 12 + length
        if end + 4 > len(content):
            return
        yield checked(begin, end)
        at = end + 4
