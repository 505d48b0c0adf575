"""Tables as other programs write them."""

import pytest

from tests.motions import refuses
from tests.recorded import TIMES, X, is_motion, table
from torchds import load
from torchds.errors import FileError

FORMS = {
    "semicolons": {"separator": ";"},
    "tabs": {"separator": "\t"},
    "spaces": {"separator": " "},
    "many spaces": {"separator": "   "},
    "commas and spaces": {"separator": ", "},
}


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("suffix", ["csv", "txt"])
def test_separators(file, name, suffix):
    separator = FORMS[name]["separator"]
    text = table(separator.join(["time", "x", "y"]), TIMES, *X.T, separator=separator)
    assert is_motion(load(file(text, f"a.{suffix}")))


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_decimals_by_a_comma(file, separator):
    text = table(separator.join(["time", "x", "y"]), TIMES, *X.T, separator=separator)
    assert is_motion(load(file(text.replace(".", ","))))


def test_comment_lines_are_passed_over(file):
    text = table("# recorded on a Monday, by hand\n% by hand\n# time,x,y", TIMES, *X.T)
    assert is_motion(load(file(text.replace("\n0.05", "\n# pause\n0.05"))))


def test_a_table_without_header(file):
    path = file(table("", TIMES, *X.T))
    with refuses(FileError, "no header", "time=0, positions=(1, 2)", "separated by commas"):
        load(path)
    demos = load(path, time=0, positions=(1, 2), names=("x", "y"))
    assert is_motion(demos)
    assert demos.names == ("x", "y")
