import math

import numpy as np
import pytest

from tasks.sketch import kinds
from torchds.errors import InvalidArgumentError, UnknownNameError

PAIR = kinds.many(kinds.number(-1, 1), 2, 2, "coordinates")
PERSON = kinds.record(name=(kinds.text(5), "Ann"), at=(kinds.maybe(PAIR), None))
OPTIONS = {"a": 1, "b": None, "c": "stable-trajectory", "d": True}
STROKE = kinds.rising_rows(5, 100.0, 1.0)


@pytest.mark.parametrize(
    ("kind", "value", "kept"),
    [
        (kinds.number(-1, 1), 1, 1.0),
        (kinds.whole(0, 3), 3, 3),
        (kinds.window, 0, 0),
        (kinds.window, 7, 7),
        (kinds.text(3), "abc", "abc"),
        (kinds.one_of("a", "b"), "b", "b"),
        (PAIR, [0, 1], (0.0, 1.0)),
        (PERSON, {}, {"name": "Ann", "at": None}),
        (PERSON, {"at": (0, 0.5)}, {"name": "Ann", "at": (0.0, 0.5)}),
        (STROKE, [[0, 0, 0], [1, 1, 1]], ((0, 0, 0), (1, 1, 1))),
        (STROKE, np.array([[0, 0, 0], [1, 1, 1.0]]), ((0, 0, 0), (1, 1, 1))),
        (kinds.options, OPTIONS, OPTIONS),
    ],
)  # fmt: skip
def test_a_kind_keeps_what_it_takes_and_takes_what_it_kept(kind, value, kept):
    found = kind("here", value)
    assert found == kept and kind("here", found) == kept


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        (kinds.number(-1, 1), 2, "here has to be a number from -1 to 1, got 2"),
        (kinds.number(-1, 1), math.nan, "here has to be a number .*, got nan"),
        (kinds.number(-1, 1), True, "got True"),
        (kinds.number(-1, 1), "1", "got '1'"),
        (kinds.whole(0, 3), 1.0, "a whole number from 0 to 3, got 1.0"),
        (kinds.window, 4, "0 for none, or an odd number from 5 to 501, got 4"),
        (kinds.text(3), "abcd", "at most 3 characters"),
        (kinds.text(3), "a\n", "on one line"),
        (kinds.one_of("a", "b"), ["a"], "'a' or 'b', got"),
        (PAIR, [0, 2], r"here\[1\] has to be a number"),
        (PAIR, [0], "has to have 2 coordinates, got 1"),
        (PAIR, 0, "a list of coordinates, got 0"),
        (PERSON, [], "an object with name, at"),
        (PERSON, {"at": [0, 3]}, r"here\.at\[1\] has to be"),
        (STROKE, [[0, 0, 0]], "at least two points at different times and places, got 1; draw a line"),
        (STROKE, [], "at least two points"),
        (STROKE, [[0, 1, 1], [1, 1, 1], [2, 1, 1]], "got 3 at one place; draw a line"),
        (STROKE, [[0, 0, 0], [0, 1, 1]], "different times and places, got 1;"),
        (STROKE, [[1, 0, 0], [0.5, 1, 1]], "have to rise, they go back from 1.0 to 0.5 s at row 1"),
        (STROKE, [[0, 0, 0], [1, 1, math.inf]], r"here\[1\] has to be rows .* of finite numbers"),
        (STROKE, [[0, 0, 0], [101, 1, 1]], r"here\[1\] has to be"),
        (STROKE, [[0, 0], [1, 1]], r"rows \[t, x1, x2\]"),
        (STROKE, [[0, 0, 0], [1, 1]], r"rows \[t, x1, x2\]"),
        (STROKE, [[0, 0, "0"], [1, 1, 1]], r"rows \[t, x1, x2\]"),
        (STROKE, [[0, 0, None], [1, 1, 1]], r"rows \[t, x1, x2\]"),
        (STROKE, [[0, 0, 10**400], [1, 1, 1]], r"rows \[t, x1, x2\]"),
        (STROKE, [[0, 0, 0]] * 6, "at most 5 rows, got 6"),
        (kinds.options, {"optimizer": "my_file.py:Mine"}, "here.optimizer has to be .* give a place on the command line"),
        (kinds.options, {"mixture": "../a.npz"}, "has to be a name"),
        (kinds.options, {"noise": math.nan}, "has to be finite"),
        (kinds.options, {"updates": 10**400}, "has to be a whole number below 2.63 in size, got"),
        (kinds.options, {"noise": [1]}, "has to be a name, a number, true, false or null"),
        (kinds.options, 3, "an object of options"),
    ],
)  # fmt: skip
def test_what_a_kind_refuses_is_said_with_its_place(kind, value, words):
    with pytest.raises(InvalidArgumentError, match=words) as refused:
        kind("here", value)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 300


def test_a_name_that_a_record_does_not_have_is_unknown():
    with pytest.raises(UnknownNameError, match=r"unknown name in here 'nam'. Did you mean 'name'"):
        PERSON("here", {"nam": "Bo"})


def test_of_points_at_one_time_the_first_is_kept():
    assert STROKE("here", [[0, 0, 0], [1, 1, 1], [1, 0, 0], [2, 0, 1]]) == ((0, 0, 0), (1, 1, 1), (2, 0, 1))
