"""Files that are brought to the page."""

import pytest

pytest.importorskip("nicegui")

import json

from tests import drawn
from tests.train.view.studio.test_controls import Problems
from torchds.errors import InvalidArgumentError
from train.view.studio.asking import bring
from train.view.studio.window import Window

CSV = "t,x,y\n" + "".join(f"{0.1 * i},{i},{i * i}\n" for i in range(30))


@pytest.fixture
def window():
    return Window(Problems(drawn.problem()))


@pytest.mark.parametrize("name", ["a.json", "../../a.json", "A.JSON", "é/ü.json", "x" * 400 + ".json"])
def test_a_problem_is_read_whatever_its_file_is_called(window, name):
    brought = drawn.problem(components=2)
    bring(window, name, json.dumps(brought.to_json()).encode())
    assert window.studio.problem == brought


def test_recordings_stand_beside_the_drawing(window):
    bring(window, "../motion.CSV", CSV.encode())
    assert len(window.studio.problem.strokes) == 3


@pytest.mark.parametrize(
    "name, content",
    [
        ("..", b""),
        ("", b"x"),
        ("a.json", b"{"),
        ("a.json", b"\xff"),
        ("a.csv", b"t,x,y\n0,0,0\n1,nan,1\n"),
        ("a.mat", b"no"),
        ("a." + "x" * 300, b""),
    ],
)
def test_what_cannot_be_read_is_a_sentence_with_its_name_and_changes_nothing(window, name, content):
    with pytest.raises(InvalidArgumentError) as refused:
        bring(window, name, content)
    assert name in str(refused.value) and "/tmp" not in str(refused.value)
    assert window.studio.problem == drawn.problem()
