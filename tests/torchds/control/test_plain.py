"""A tick with numpy alone, against the formula term by term."""

import numpy as np

from tests.torchds.control.test_plan import values
from torchds.control.plain import step
from torchds.control.plan import plan


def by_formula(given, x):
    """Eq. 1-3 with W_k (x − μ_k) as the plan has it."""
    D = len(x)
    z = np.einsum("kij,j->ki", given["factors"], x - given["_center"]) + given["_offset"].reshape(-1, D)
    h = np.exp(given["_log_scale"] - 0.5 * (z**2).sum(-1))
    return (h[:, None] * (given["A"] @ x + given["b"])).sum(0) / h.sum()


def test_one_tick_is_the_formula():
    given, row = values(K=4, D=3, O=3), np.zeros(6)
    made = plan(given, 0.1)
    made.shift[:] = 0.2, -0.1, 0.3
    tick, rng = step(made), np.random.default_rng(1)
    for x in rng.normal(size=(20, 3)):
        assert tick(x, np.zeros(3), row) == 0
        np.testing.assert_allclose(row[3:], by_formula(given, x - made.shift), rtol=1e-13)
        np.testing.assert_allclose(row[:3], x + 0.1 * row[3:], rtol=1e-13)


def test_a_share_of_the_speed_and_the_bounds_are_taken_in_turn():
    given = values(K=1, D=2, O=2) | {"A": -np.eye(2)[None], "b": np.zeros((1, 2))}
    made, row = plan(given, 0.1), np.zeros(4)
    made.limits[1:] = 1.0, 0.05, 0.5
    assert step(made)(np.array([4.0, 0.0]), np.zeros(2), row) == 3  # half of 4, cut to 1, and that to 0.05
    assert row.tolist() == [4.0 - 0.005, 0.0, -0.05, 0.0]
