"""Runs as data frames.

Stability: stable.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchds.errors import FileError, MissingPackageError
from torchds.files import read_sealed

if TYPE_CHECKING:
    from pandas import DataFrame

RESULTS = "results.json"


def to_dataframe(folder: str | Path) -> DataFrame:
    """What a run has cost, one row for each update and run of its batch.

    Args:
        folder: of a finished run of `python -m train`, which has a results.json; or of one that `TensorBoard` wrote.

    Returns:
        Columns `update`, `run`, `rollouts`, `cost`, and `cost/<name>` for each of its terms; costs that were not finite are
        NaN. From TensorBoard's file a row for each step, which is the index `rollouts`, and a column for each tag.

    Raises:
        MissingPackageError: pandas is not installed.
        FileError: there is neither file, or it is damaged.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingPackageError("pandas", "monitor", "a data frame") from error
    folder = Path(folder)
    if (folder / RESULTS).is_file():
        return pandas.DataFrame(_by_run(read_sealed(folder / RESULTS, unsealed=("rollouts", "cost", "terms"))))
    if not any(folder.glob("events.out.tfevents.*")):
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
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    except ImportError as error:
        raise MissingPackageError("tensorboard", "monitor", "reading TensorBoard's file") from error
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    return {tag: {event.step: event.value for event in events.Scalars(tag)} for tag in events.Tags()["scalars"]}
