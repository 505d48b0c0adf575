"""What a problem was before, and what was undone."""

from __future__ import annotations

import time

from tasks.sketch import Problem

SERIES = 1.0  # s between two changes of one slider


class History:
    """Steps back and forth."""

    def __init__(self) -> None:
        self._past: list[Problem] = []
        self._future: list[Problem] = []
        self._last: tuple[tuple[str, ...], Problem | None, float] = ((), None, 0.0)  # change of a series

    def add(self, before: Problem) -> None:
        """A step from this problem to another one; what was undone is gone."""
        self._past.append(before)
        self._future.clear()

    def join(self, names: tuple[str, ...], before: Problem, after: Problem) -> None:
        """Make the last step, of these fields, one with that before where both are of one series, as a slider makes them."""
        last, made, then = self._last
        now = time.monotonic()
        if after is not before and before is made and names == last and now - then < SERIES:
            self._past.pop()
        self._last = names, after, now

    def back(self, now: Problem) -> Problem:
        """The problem before this one; this one where there is none."""
        return self._step(self._past, self._future, now)

    def forth(self, now: Problem) -> Problem:
        """What was undone last; this one where nothing was."""
        return self._step(self._future, self._past, now)

    @staticmethod
    def _step(begin: list[Problem], end: list[Problem], now: Problem) -> Problem:
        if not begin:
            return now
        end.append(now)
        return begin.pop()
