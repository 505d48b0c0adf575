"""Which columns of a table are what: as said by the arguments, else as their names say, and never by a guess.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from torchds.errors import FileError, UnknownNameError
from torchds.recordings.columns import AXES, Named, base_names, rank
from torchds.recordings.reading import Column, Columns, Reading, is_column, several


class Layout(NamedTuple):
    """Numbers of columns.

    Attributes:
        x: positions.
        v: their velocities, in the same order; [] for none.
        stiffness: [] for none.
        t: time, and its fraction where that stands in a column of its own; [] for none.
        demo: the column that numbers demonstrations; None for none.
        left_out: what is used for nothing, with what it is.
    """

    x: list[int]
    v: list[int]
    stiffness: list[int]
    t: list[int]
    demo: int | None
    left_out: dict[str, str]


def layout(
    path: Path, columns: Sequence[Named], header: Sequence[str], usable: Callable[[int], bool], how: Reading
) -> Layout:
    """The layout of a table.

    Args:
        path: of the file, for messages.
        columns: what the names say.
        header: the names themselves.
        usable: whether a column holds numbers.
        how: arguments of the reader.

    Raises:
        FileError: it cannot be told which columns are positions; the message has the call that says it.
        UnknownNameError: a column that is not there.
    """

    def find(column: Column) -> int:
        if isinstance(column, int) and not isinstance(column, bool) and 0 <= column < len(header):
            return column
        for names in (list(header), [c.name for c in columns]):
            if column in names:
                return names.index(str(column))
        raise UnknownNameError(f"column of {path.name}", str(column), header)

    def given(value: Columns | None) -> list[int] | None:
        chosen = several(value)
        return None if chosen is None else [find(column) for column in chosen]

    ignored = given(how.get("ignore")) or []
    split = how.get("split")
    demo = find(split) if is_column(split) else None
    x, v, s = (given(how.get(name)) for name in ("positions", "velocities", "stiffness"))  # type: ignore[arg-type]
    t = None if how.get("time") is None else [find(how["time"])]  # type: ignore[arg-type]
    taken = {*ignored, *(x or []), *(v or []), *(s or []), *(t or []), *([] if demo is None else [demo])}
    free = {i: c for i, c in enumerate(columns) if i not in taken and usable(i)}

    def of(kind: str) -> list[int]:
        return [i for i, c in free.items() if c.kind == kind]

    if t is None:
        t = _clock(path, columns, header, of("time"), of("part of a second"))
    if demo is None and split is not False and len(of("demonstration")) == 1:
        (demo,) = of("demonstration")
    if x is None:
        x = _positions(path, free, header, of, bool(how.get("ignore")))
    if not x:
        raise FileError(
            f"{path}: none of the columns {', '.join(header)} is a position; say which are, positions=('...', '...')"
        )
    if v is None:
        v = _velocities(path, columns, header, x, of("velocity"), how.get("positions") is not None)
    if len(v) not in (0, len(x)):
        raise FileError(
            f"{path}: the velocities are {', '.join(header[i] for i in v)} but the positions "
            f"{', '.join(header[i] for i in x)}; give one for each position, velocities=(...), or none, velocities=()"
        )
    if s is None:
        keys = {columns[i].key for i in x}
        s = [i for i in of("stiffness") if _is_stiffness(columns[i], keys)]
    used = {*x, *v, *s, *t, *([] if demo is None else [demo]), *ignored}
    left: dict[str, str] = {
        header[i]: c.kind for i, c in free.items() if i not in used and how.get("positions") is None
    }
    return Layout(x, v, s, t, demo, left)


def _clock(
    path: Path, columns: Sequence[Named], header: Sequence[str], times: list[int], fractions: list[int]
) -> list[int]:
    """The column of time and that of its fraction; other stamps are second clocks."""
    for order in (0, 1, 2):
        found = [i for i in times if rank(columns[i]) == order]
        if len(found) > 1:
            names = [header[i] for i in found]
            raise FileError(f"{path}: the columns {' and '.join(names)} could be time; choose with time={names[0]!r}")
        if found:
            own = [i for i in fractions if columns[i].words[:-1] == columns[found[0]].words[:-1]]
            seconds = columns[found[0]].words[-1].startswith("sec")
            return [*found, *own] if seconds and len(own) == 1 else found
    return []


def _positions(
    path: Path, free: dict[int, Named], header: Sequence[str], of: Callable[[str], list[int]], ignoring: bool
) -> list[int]:
    x = of("position")
    quaternion = of("quaternion")
    unknown = of("unknown")
    if quaternion:
        listed, place = ", ".join(header[i] for i in quaternion), tuple(header[i] for i in x)
        raise FileError(
            f"{path}: the columns {listed} are a quaternion, on whose sphere no linear system stays; pass positions={place!r} "
            f"for the place alone, or positions={(*place, *(header[i] for i in quaternion))!r} and make a rotation vector of "
            "the last four by torchds.poses.from_poses(...)"
        )
    keys = {free[i].key for i in x}
    stray = [i for i in of("stiffness") if not _is_stiffness(free[i], keys)]
    ends = [_last(free[i]) for i in x if len(free[i].words) > 1 and _last(free[i]) in AXES]
    twice = len(set(ends)) < len(ends) or bool(stray)
    prefixed = stray + [i for i in x if len(free[i].words) > 1] if twice else []
    if doubtful := sorted({*unknown, *prefixed}):
        names = tuple(header[i] for i in doubtful)
        surest = tuple(header[i] for i in x if i not in doubtful) or (*names[: (len(names) + 1) // 2],)
        others = tuple(name for name in names if name not in surest) or names
        raise FileError(
            f"{path}: cannot tell which columns are positions: {', '.join(names)}. Say which are, such as "
            f"positions={surest!r}, or leave out the others, ignore={others!r}"
        )
    return x


def _is_stiffness(column: Named, positions: set[str]) -> bool:
    """Whether a name that may be short for stiffness, `s_x` or `s_1`, is: it names a position, or only a number."""
    of, last = "_".join(column.words[1:]), column.words[-1]
    return column.words[0].startswith("stiffness") or last.isdigit() or of in positions


def _last(column: Named) -> str:
    return column.words[-1]


def _velocities(
    path: Path, columns: Sequence[Named], header: Sequence[str], x: list[int], v: list[int], chosen: bool
) -> list[int]:
    """The velocity of each position, by their names."""
    by_key = {columns[i].key: i for i in x}
    by_axis: dict[str, list[int]] = {}
    for i in x:
        by_axis.setdefault(_last(columns[i]) if columns[i].words else "", []).append(i)
    owner: dict[int, int] = {}
    for j in v:
        for base in base_names(columns[j].words):
            alone = by_axis.get(base, [])
            position = by_key.get(base, alone[0] if len(alone) == 1 else None)
            if position is not None and position not in owner:
                owner[position] = j
                break
    found = [owner[i] for i in x if i in owner]
    strangers = [j for j in v if j not in found and not {"angular", "omega"} & set(columns[j].words)]
    if len(found) == len(x) and (chosen or not strangers):
        return found
    if not v or (chosen and not found):
        return []
    listed = found if len(found) > len(strangers) else strangers or found
    raise FileError(
        f"{path}: the velocities are {', '.join(header[i] for i in sorted({*found, *listed}))} but the positions "
        f"{', '.join(header[i] for i in x)}; name the velocity of each position, "
        f"{', '.join('v_' + columns[i].name for i in x)}, or say which they are, velocities=(...), or take none, velocities=()"
    )
