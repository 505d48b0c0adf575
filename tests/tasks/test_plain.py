"""Values of options through JSON and back, by their type."""

import json
import math
from pathlib import Path
from typing import Literal

import pytest

from tasks.plain import fits, plain, restored, words

THERE_AND_BACK = [
    ((0.5, math.inf), tuple[float, float]),
    ((1, 2, 3), tuple[int, ...]),
    ((("a", -math.inf),), tuple[tuple[str, float], ...]),
    ((), tuple[int, ...]),
    ((1, "a"), tuple),
    ([Path("a"), Path("b/c.csv")], list[Path]),
    (Path("a/b"), Path),
    (Path("a/b"), Path | None),
    (None, Path | None),
    (math.inf, float),
    (-math.inf, float | None),
    ("inf", str),
    ((1.0, 2.0), tuple[float, float] | None),
    ("round", Literal["round", "square"]),
    (3, float),
    (True, bool),
]


@pytest.mark.parametrize(("value", "kind"), THERE_AND_BACK)
def test_a_value_comes_back_from_json_as_its_type_has_it(value, kind):
    said = json.loads(json.dumps(plain(value), allow_nan=False))
    assert said == plain(value) and fits(said, kind)
    again = restored(said, kind)
    assert again == value and type(again) is type(value)


def test_what_is_no_number_comes_back_too():
    assert plain(math.nan) == "nan" and math.isnan(restored("nan", float))


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        ([1.0], tuple[float, float]),
        ([1.0, "a"], tuple[float, float]),
        ("ab", tuple[str, ...]),
        ("many", float),
        (True, int),
        (1.5, int),
        (None, Path),
        ("round", Literal["square"]),
    ],
)
def test_a_value_of_another_type_does_not_fit(value, kind):
    assert not fits(value, kind)


def test_types_are_said_in_words():
    assert words(int | None) == "a whole number or nothing"
    assert words(Literal["a", "b"]) == "'a' or 'b'"
