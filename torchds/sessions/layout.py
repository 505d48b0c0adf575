"""Which columns the files of a session have, with their units.

Stability: stable.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError

TIME = "time [s]"


@dataclass(frozen=True)
class Layout:
    """Names of the columns, as in "x [m]".

    Args:
        position: of a motion.
        velocity: of a motion; "v_x [m/s]" for "x [m]" by default.
        stiffness: that a policy asks for; none by default.
        measured: what a recording has beside the positions, forces say.
        optional: of `measured`, those that are zero where they are missing.
        start: how far from the first point of its reference a recording may start, for each position and in its unit; a
            tenth of the motion's size by default.
        lever: how much one unit of each position counts where distances are judged, as 0.2 m for a radian; 1 by default.
        max_gap: longest time between two samples of a recording [s], where the time step is not longer.

    Raises:
        InvalidArgumentError: no positions, a name twice or without a unit, or numbers that are not one positive for each.

    Example:
        >>> Layout(("x [m]", "angle [rad]")).reference
        ('time [s]', 'x [m]', 'angle [rad]', 'v_x [m/s]', 'v_angle [rad/s]')
    """

    position: tuple[str, ...]
    velocity: tuple[str, ...] = ()
    stiffness: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    start: tuple[float, ...] = ()
    lever: tuple[float, ...] = ()
    max_gap: float = 0.1

    def __post_init__(self) -> None:
        n = len(self.position)
        if not self.velocity:
            object.__setattr__(self, "velocity", tuple(_rate(name) for name in self.position))
        if not self.lever:
            object.__setattr__(self, "lever", (1.0,) * n)
        names = (*self.reference, *self.measured)
        wrong = [name for name in names if not re.fullmatch(r"[^,\"\n]*\S \[[^,\"\n\]]+\]", name)]
        if not n or wrong or len(set(names)) < len(names) or not set(self.optional) <= set(self.measured):
            raise InvalidArgumentError(
                "columns have to be different names with units, as 'x [m]', at least one position among them, and optional "
                f"ones among the measured; got {', '.join(map(repr, wrong or names))}"
            )
        for what in ("velocity", "lever", "start"):
            given = getattr(self, what)
            if len(given) not in ((0, n) if what == "start" else (n,)) or (
                what != "velocity" and not all(value > 0 for value in given)
            ):
                raise InvalidArgumentError(f"{what} has to have one for each of the {n} positions, got {given}")
        if not self.max_gap > 0:
            raise InvalidArgumentError(f"max_gap has to be positive, got {self.max_gap}")

    @classmethod
    def of(cls, demos: Demonstrations, *, stiffness: Sequence[str] = (), measured: Sequence[str] = ()) -> Layout:
        """The columns of a motion that was learned from demonstrations, with their names and units."""
        position = tuple(f"{name} [{unit or '1'}]" for name, unit in zip(demos.names, demos.units, strict=True))
        return cls(position, stiffness=tuple(stiffness), measured=tuple(measured))

    @property
    def reference(self) -> tuple[str, ...]:
        """All columns of a reference."""
        return (TIME, *self.position, *self.velocity, *self.stiffness)

    @property
    def recording(self) -> tuple[str, ...]:
        """All columns of a recording."""
        return (TIME, *self.position, *self.measured)

    @property
    def units(self) -> tuple[str, ...]:
        """Of the positions."""
        return tuple(re.fullmatch(r".* \[(.*)\]", name)[1] for name in self.position)  # type: ignore[index]


def _rate(name: str) -> str:
    """The velocity of a position; a name that is none is left to be refused."""
    return re.sub(r"^(.*) \[(.*)\]$", r"v_\1 [\2/s]", name)
