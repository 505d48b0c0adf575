"""Clocks of recordings: stamps become seconds, their unit is taken from name or size, and their steps are compared.

Stability: experimental.
"""

from __future__ import annotations

import numpy as np

from torchds.errors import FileError

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
SPELLED = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millis", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecond", "nanoseconds"),
    "min": ("min", "minute", "minutes"),
}
EPOCH = (3e8, 4.2e9)  # seconds from 1970 to the years 1979 and 2103
EVEN = 1e-3  # relative difference of time steps that count as equal


def unit_named(text: str) -> str | None:
    """The unit of time that is spelled so, in small letters; None if it is none."""
    return next((unit for unit, spelled in SPELLED.items() if text in spelled), None)


def seconds(where: str, stamps: np.ndarray, unit: str | None, *, whole: bool = False) -> np.ndarray:
    """Stamps `(T,)` in seconds.

    Args:
        where: the file, for messages.
        stamps: floats, or whole numbers of any size as Python's, None where one is missing.
        unit: of the stamps; None to take seconds, unless their size says something else.
        whole: whether the file writes whole numbers, of which seconds are not taken for granted.

    Raises:
        FileError: whole numbers whose unit cannot be told.
    """
    if unit is None:
        unit = _unit_by_size(where, stamps, whole)
    if stamps.dtype == object:  # differences of whole numbers are exact, their floats are not
        first = next((stamp for stamp in stamps if stamp is not None), 0)
        return np.array([np.nan if each is None else int(each - first) for each in stamps], dtype=float) * UNITS[unit]
    return stamps.astype(float) * UNITS[unit]


def _unit_by_size(where: str, stamps: np.ndarray, whole: bool) -> str:
    values = np.array([np.nan if stamp is None else float(stamp) for stamp in stamps])
    values = values[np.isfinite(values)]
    steps = np.abs(np.diff(values))
    if not len(steps) or not (usual := float(np.median(steps))) > 0:
        return "s"
    for unit, size in UNITS.items():
        # a date, in steps that a recording may have
        if unit != "min" and EPOCH[0] <= values[0] * size <= EPOCH[1] and 1e-5 <= usual * size <= 10:
            return unit
    if not (np.mod(values, 1) == 0).all():
        return "s"
    if 500 <= usual <= 2e5:
        return "us"
    if 5e5 <= usual <= 2e8:
        return "ns"
    if not whole and usual < 500:
        return "s"
    raise FileError(
        f"{where}: time goes on in steps of {usual:g}, whole numbers whose unit cannot be told; pass time_unit= one of "
        f"{', '.join(map(repr, UNITS))}"
    )


def even_step(where: str, t: np.ndarray, n_samples: int) -> float:
    """The time step of times `(T,)` [s] that are equally spaced.

    Raises:
        FileError: they are not, or not one for each sample; the message has all digits and the call that mends it.
    """
    if len(t) != n_samples:
        raise FileError(f"{where}: time stamps have to be one for each of the {n_samples} positions, got {len(t)}")
    if len(t) < 2:
        raise FileError(f"{where} has to have at least two samples, got {len(t)}; leave it out")
    steps = np.diff(t)
    usual = np.median(steps)
    still = np.flatnonzero(~(steps > 0))
    bad = still if len(still) else np.flatnonzero(~(np.abs(steps - usual) <= EVEN * usual))
    if len(bad):
        row = int(bad[0])
        a, b = float(t[row]), float(t[row + 1])
        if a == b:
            advice = "the time stands still; pass duplicates='drop' to leave out the second sample"
        elif not b > a:
            advice = "the time goes back; pass duplicates='drop' to leave out samples whose time does not rise"
        else:
            advice = (
                "pass resample=True to bring the recording to equal time steps by cubic splines, or resample=0.01 to such "
                "a step in seconds" + ("; split=True if a new demonstration begins there" if b - a > 3 * usual else "")
            )
        raise FileError(
            f"{where}: the time steps have to be equal: from row {row} to row {row + 1} (counted from 0) time goes from "
            f"{a!r} to {b!r} s where {usual:.6g} s is usual; {advice}"
        )
    return float((t[-1] - t[0]) / (len(t) - 1))
