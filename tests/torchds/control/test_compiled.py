"""The compiled tick is the plain one, to the last digits."""

import numpy as np
import pytest

from tests.torchds.control.test_plan import values
from tests.torchds.kernels.comparison import needs_numba
from torchds.control import plain
from torchds.control.plan import plan


@needs_numba
@pytest.mark.slow  # compiling takes seconds
def test_random_ticks_are_those_of_numpy():
    from torchds.control import compiled

    rng = np.random.default_rng(2)
    made = plan(
        values(K=5, D=3, O=4, stiffness_A=rng.normal(size=(5, 2, 3)), stiffness_b=rng.normal(size=(5, 2))), 0.01
    )
    made.limits[1:] = 1.0, 0.3, 0.7
    made.low[:], made.high[:] = -1.0, 1.0
    ticks, rows, seen = (plain.step(made), compiled.step(made)), np.zeros((2, 9)), set()
    for x, before in zip(rng.uniform(-1, 1, (300, 3)), 0.5 * rng.normal(size=(300, 4)), strict=True):
        a, b = (tick(x, before, row) for tick, row in zip(ticks, rows, strict=True))
        np.testing.assert_allclose(rows[0], rows[1], rtol=1e-12, atol=1e-13)
        assert a == b
        seen.add(a)
    assert seen >= {0, 1, 3, 7} or len(seen) > 3
    assert ticks[1](np.full(3, 1e200), np.zeros(4), rows[0]) == -1
