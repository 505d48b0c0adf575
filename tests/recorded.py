"""Recordings as files and as arrays, for the tests of the readers."""

import struct

import numpy as np
import pytest

from tests.motions import sine

N, DT = 20, 0.01
X = np.stack([np.sin(0.1 * np.arange(N)), 0.02 * np.arange(N)], -1)  # x and y
COUNT = np.arange(N)
TIMES = DT * COUNT
MOTION, SPEED, STEP = sine(60)


def table(header, *columns, separator=","):
    """A table as text: columns of numbers, or of words."""
    cells = [[c if isinstance(c, str) else f"{c:.6f}" for c in row] for row in zip(*columns, strict=True)]
    return "\n".join([*([header] if header else []), *map(separator.join, cells)]) + "\n"


def whole(values):
    return [str(int(value)) for value in values]


def is_motion(demos, x=X, dt=DT, n=1, atol=1e-6):
    assert len(demos) == n
    assert demos.dt == pytest.approx((dt,) * n, rel=1e-6)
    np.testing.assert_allclose(demos[0].x.numpy(), x, rtol=0, atol=atol)
    return True


def cell(*items):
    array = np.empty((1, len(items)), dtype=object)
    array[0, :] = items
    return array


def write_absurd_npz(path, name):
    """A small archive whose directory says that its one array would unpack to half a gigabyte."""
    np.savez(path, **{name: np.ones(3)})
    raw = bytearray(path.read_bytes())
    struct.pack_into("<I", raw, raw.index(b"PK\x01\x02") + 24, 2**29)
    path.write_bytes(raw)
