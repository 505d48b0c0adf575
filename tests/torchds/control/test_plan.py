"""All numbers of a controller in one array."""

import numpy as np
import pytest

from torchds.control.plan import Cut, plan
from torchds.errors import InvalidArgumentError


def values(K=3, D=2, O=2, **more):
    rng = np.random.default_rng(0)
    gate = {
        "_center": np.zeros(D),
        "factors": rng.normal(size=(K, D, D)),
        "_offset": np.ones(K * D),
        "_log_scale": np.ones(K),
    }
    return gate | {"A": rng.normal(size=(K, O, D)), "b": rng.normal(size=(K, O))} | more


def test_the_parts_are_views_of_one_array():
    made = plan(values(), 0.1)
    made.shift[:] = 7.0
    assert made.numbers[4:6].tolist() == [7.0, 7.0] and made.limits.tolist() == [0.1, np.inf, np.inf, 1.0]
    assert sum(part.size for part in made[2:]) == made.numbers.size and made.sizes == (3, 2, 2, 0)


def test_the_rows_are_those_of_the_features():
    """Row o is [A_1 row o, b_1[o], A_2 row o, ...], the stiffness after the velocities."""
    given = values(stiffness_A=np.ones((3, 1, 2)), stiffness_b=5 * np.ones((3, 1)))
    rows = plan(given, 0.1).rows
    assert rows.shape == (3, 9) and rows[2].tolist() == [1, 1, 5] * 3
    np.testing.assert_array_equal(rows[1, 3:6], [*given["A"][1, 1], given["b"][1, 1]])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "got something without _center, factors"),
        (values() | {"A": np.ones((5, 3, 2, 2))}, r"got a batch of \(5,\)"),
        (values(O=1), "has to have as many velocities or more, got 1"),
        (values() | {"b": np.full((3, 2), np.nan)}, "have to be finite"),
    ],
)
def test_what_is_no_single_policy_is_refused(given, words):
    with pytest.raises(InvalidArgumentError, match=words):
        plan(given, 0.1)


def test_reasons_have_names():
    assert [part.name for part in Cut(6)] == ["ACCELERATION", "WORKSPACE"]
