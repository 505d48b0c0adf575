"""What a tick says, and the ring of ticks that is made once, before the loop begins.

Stability: stable.
"""

from __future__ import annotations

import numpy as np

from torchds.control.plan import Cut


class Tick:
    """One tick of a controller; its arrays are views that cannot be written to, and stay as they are for `history` ticks.

    Attributes:
        x: `(D,)` the position to be at, at the end of the tick.
        v: `(O,)` the velocity of the tick.
        stiffness: `(Q,)` that the policy asks for at its beginning [N/m]; empty for a policy without.
        cut: what was cut, as an integer; `reasons` says it in words.
        late: by how much it was called too late [s]; 0.0 where it was on time.
    """

    __slots__ = ("_row", "_v", "_x", "cut", "late", "stiffness", "v", "x")

    def __init__(self, row: np.ndarray, D: int, O: int) -> None:
        self._row, self._x, self._v = row, row[:D], row[D : D + O]
        shown = row.view()
        shown.flags.writeable = False
        self.x, self.v, self.stiffness = shown[:D], shown[D : D + O], shown[D + O :]
        self.cut, self.late = 0, 0.0

    @property
    def reasons(self) -> tuple[str, ...]:
        """What was cut, in words: "speed", "acceleration", "workspace"."""
        return tuple(str(part.name).lower() for part in Cut(self.cut))

    def __repr__(self) -> str:
        """The numbers of the tick."""
        return f"Tick(x={self.x}, v={self.v}, stiffness={self.stiffness}, cut={self.reasons}, late={self.late})"


def ring(n: int, D: int, O: int, Q: int) -> list[Tick]:
    """`n` ticks over one array."""
    return [Tick(row, D, O) for row in np.zeros((n, D + O + Q))]
