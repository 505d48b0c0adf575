"""What the name of a column says about it: time, position, velocity, stiffness, or something that is none of these.

Stability: experimental.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

from torchds.recordings.clock import unit_named

Kind = Literal[
    "time",
    "part of a second",
    "counter",
    "demonstration",
    "position",
    "velocity",
    "acceleration",
    "force",
    "quaternion",
    "stiffness",
    "unknown",
]

TIME = {"t", "time", "times", "timestamp", "stamp", "clock", "epoch", "elapsed", "secs", "sec", "seconds"}
NESTED_TIME = {"time", "timestamp", "stamp", "secs", "sec"}
FRACTIONS = {"nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds", "nanos"}
COUNTERS = {
    "seq",
    "sequence",
    "counter",
    "count",
    "index",
    "idx",
    "row",
    "sample",
    "frame",
    "line",
    "no",
    "nr",
    "step",
    "n",
}
DEMONSTRATIONS = {
    "demo", "demos", "demonstration", "trial", "episode", "traj", "trajectory", "run", "repetition", "rep", "id", "attempt"
}  # fmt: skip
FORCES = {
    "force", "forces", "torque", "torques", "wrench", "effort", "efforts", "tau", "fx", "fy", "fz", "tx", "ty", "tz", "f",
    "current", "load",
}  # fmt: skip
ACCELERATIONS = {"acc", "acceleration", "accelerations", "ax", "ay", "az", "ddx", "ddy", "ddz", "ddq"}
VELOCITIES = {"v", "vel", "velocity", "velocities", "twist", "dot", "speed", "qd", "omega", "wx", "wy", "wz"}
QUATERNIONS = {"quat", "quaternion", "orientation", "qx", "qy", "qz", "qw"}
AXES = {"x", "y", "z", "w"}
POSITIONS = {
    "pos", "position", "positions", "joint", "joints", "j", "q", "theta", "phi", "psi", "alpha", "beta", "gamma", "angle",
    "roll", "pitch", "yaw", "px", "py", "pz", "rx", "ry", "rz", "x", "y", "z",
}  # fmt: skip


class Named(NamedTuple):
    """What the header says of one column.

    Attributes:
        name: without its unit.
        unit: "" where none is given.
        kind: what it holds.
        words: the name in small letters, in words.
    """

    name: str
    unit: str
    kind: Kind
    words: tuple[str, ...]

    @property
    def key(self) -> str:
        """The name by which velocities find their positions."""
        return "_".join(self.words)


def named(header: str) -> Named:
    """What a name such as "time [s]", "%time", "field.pose.position.x" or "v_x (m/s)" says."""
    name, unit = header.strip().lstrip("%#").strip(), ""
    if match := re.fullmatch(r"(.*\S)\s*[\[(]([^\])]*)[\])]", name):
        name, unit = match[1], match[2].strip()
    separate = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = tuple(re.sub(r"[\W_]+", " ", separate).lower().split())
    return Named(name, unit, _kind(words, unit), words)


def time_unit(column: Named) -> str | None:
    """The unit of a column of time, from its brackets or the end of its name; None if it says none."""
    if column.unit:
        return unit_named(column.unit.lower())
    last = column.words[-1] if column.words else ""
    return unit_named(last) if last != "t" and (len(column.words) > 1 or last.startswith("sec")) else None


def rank(column: Named) -> int:
    """How sure a column of time is the clock: 0 for `t` and `time`, 1 for other names alone, 2 for parts of a message."""
    words = column.words[:-1] if len(column.words) > 1 and unit_named(column.words[-1]) else column.words
    if words in (("t",), ("time",)):
        return 0
    return 1 if len(words) == 1 or words == ("time", "stamp") else 2


def _kind(words: Sequence[str], unit: str) -> Kind:
    """By the most telling word first."""
    if not words or words[-1] in ("name", "names", "label"):
        return "unknown"
    seen, first, last = {re.sub(r"\d+$", "", word) or word for word in words}, words[0], words[-1]
    stem = re.sub(r"\d+$", "", last)
    timed = words[:-1] if len(words) > 1 and unit_named(last) else words
    if stem in FRACTIONS:
        return "part of a second"
    if (len(timed) == 1 and timed[0] in TIME) or timed[-1] in NESTED_TIME or last in ("secs", "nsecs"):
        return "time"
    if (
        (len(words) == 1 or last in ("id", "nr", "no"))
        and {first, stem} & DEMONSTRATIONS
        and first not in ("frame", "child")
    ):
        return "demonstration"
    if last in COUNTERS:
        return "counter"
    if first.startswith("stiffness") or (first in ("s", "k", "stiffness") and len(words) == 2):
        return "stiffness"  # s_x beside no column x is looked at again, see `layout`
    if seen & FORCES and not seen & {"position", "pos"}:
        return "force"
    if seen & QUATERNIONS:
        return "quaternion"
    if seen & ACCELERATIONS or unit.replace("²", "2").replace("^", "").endswith("s2"):
        return "acceleration"
    if seen & VELOCITIES or base_names(words, glued_only=True) or unit.lower().endswith(("/s", "/sec")):
        return "velocity"
    if (stem in POSITIONS and (len(words) == 1 or last in AXES or last.isdigit() or stem in POSITIONS)) or (
        last.isdigit() and len(words) > 1 and re.sub(r"\d+$", "", words[-2]) in POSITIONS
    ):
        return "position"
    return "unknown"


def base_names(words: Sequence[str], glued_only: bool = False) -> list[str]:
    """Names of positions that a velocity of this name could belong to, the likeliest first; [] if it is none."""
    name = "_".join(words)
    patterns = [r"[vd](x|y|z|q|theta|phi|psi|alpha|beta|gamma|angle|roll|pitch|yaw)(\d*)", r"d(.+)dt", r"(.+?)dot(\d*)"]
    if not glued_only:
        patterns = [
            r"(?:v|vel|velocity|velocities|d|speed)_(.+)",
            r"(.+?)_(?:v|vel|velocity|dot|speed)(\d*)",
            r"d_?(.+?)_dt",
            r"d(.+)_dt",
            r"vel(.+)",
            *patterns,
        ]
    found = ["".join(part for part in match.groups() if part) for p in patterns if (match := re.fullmatch(p, name))]
    if not glued_only and len(words) > 1:
        found += [words[-1]] if words[-1] in AXES else []
        for theirs, ours in (("velocity", "position"), ("vel", "pos"), ("velocities", "positions")):
            found += [name.replace(theirs, ours)] if theirs in name else []
    return found
