import json
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from tasks.sketch import Problem
from tests.tasks.sketch.drawn import FULL, strokes
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError

EMPTY = {"torchds": "problem", "version": 1}


@pytest.mark.parametrize("problem", [Problem(), FULL])
def test_a_problem_comes_back_from_its_file_as_it_was(problem, tmp_path):
    assert Problem.from_json(json.loads(json.dumps(problem.to_json()))) == problem
    problem.write(tmp_path / "a.json")
    assert Problem.read(tmp_path / "a.json") == problem
    problem.write(tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_file_is_for_people_one_line_for_each_stroke_and_each_name(tmp_path):
    FULL.write(tmp_path / "a.json")
    lines = (tmp_path / "a.json").read_text().splitlines()
    assert len(lines) < 50 and '  "samples": 41,' in lines and sum(line.startswith("    [[") for line in lines) == 3 + 1


def test_what_a_file_leaves_out_is_as_usual():
    problem = Problem.from_json(EMPTY)
    assert problem == Problem() and problem.weights["acceleration"] == 1e-4 and problem.body is None
    assert Problem.from_json({**EMPTY, "body": {}}).body["stiffness"] == 200.0


def test_a_problem_is_checked_wherever_one_is_made():
    with pytest.raises(InvalidArgumentError, match="components has to be a whole number from 1 to 12, got 13"):
        replace(FULL, components=13)
    with pytest.raises(InvalidArgumentError, match="smoothing has to be at most the 41 samples"):
        replace(FULL, smoothing=43)
    with pytest.raises(FrozenInstanceError):
        FULL.samples = 50


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"torchds": "policy"}, InvalidArgumentError, "has to be an object with"),
        ({"version": 2}, InvalidArgumentError, "version has to be 1, got 2"),
        ({"stroke": []}, UnknownNameError, "Did you mean 'strokes'"),
        ({"strokes": [[[0, 0, 0]]]}, InvalidArgumentError, r"strokes\[0\] has to have at least two points"),
        ({"strokes": [[[0, 0, 0]] * 100_000]}, InvalidArgumentError, "at most 5000 rows, got 100000"),
        ({"strokes": [[[0, 0, 0], [float("nan"), 1, 1]]]}, InvalidArgumentError, r"strokes\[0\]\[1\] has to be"),
        ({"samples": 9}, InvalidArgumentError, "samples has to be a whole number from 10 to 2000, got 9"),
        ({"condition": "stable"}, InvalidArgumentError, "condition has to be 'none' or 'seds' or 'p-qlf'"),
        ({"start": [0]}, InvalidArgumentError, "start has to have 2 coordinates"),
        ({"walls": [[[0, 0], [1, 1], [2, 2]]]}, InvalidArgumentError, r"walls\[0\] has to have 2 ends, got 3"),
        ({"regions": [{"center": [0, 0]}]}, InvalidArgumentError, r"regions\[0\].radius has to be a number"),
        ({"weights": {"goal": -1}}, InvalidArgumentError, r"weights.goal has to be a number from 0"),
        ({"weights": {"goals": 1}}, UnknownNameError, "Did you mean 'goal'"),
        ({"body": {"mass": 0}}, InvalidArgumentError, "body.mass has to be a number from 1e-06"),
        ({"learners": []}, InvalidArgumentError, "learners has to have 1 to 2 learners, got 0"),
    ],
)
def test_a_wrong_value_gets_a_sentence_and_its_file(change, error, words, tmp_path):
    with pytest.raises(error, match=words):
        Problem.from_json({**EMPTY, **change})
    (tmp_path / "a.json").write_text(json.dumps({**EMPTY, **change}))
    with pytest.raises(InvalidArgumentError, match="a.json: .*" + words):
        Problem.read(tmp_path / "a.json")


def test_a_file_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.json").write_text("{")
    for path, words in ((tmp_path / "a.json", "is not readable JSON"), (tmp_path / "b.json", "no such file")):
        with pytest.raises(FileError, match=words):
            Problem.read(path)


def test_demonstrations_are_the_strokes_at_even_times():
    problem = Problem(strokes=strokes(2), samples=200, unit="m")
    demos = problem.demonstrations()
    for stroke, d in zip(problem.strokes, demos, strict=True):
        t, *x = np.array(stroke).T
        at = np.linspace(t[0], t[-1], 200)
        assert d.dt == pytest.approx((t[-1] - t[0]) / 199)
        assert np.allclose(d.x, np.stack([np.interp(at, t, column) for column in x], -1), rtol=0, atol=1e-12)
    assert demos.units == ("m", "m")


def test_smoothing_and_duration_are_those_of_demonstrations():
    plain = Problem(strokes=strokes(2)).demonstrations()
    found = Problem(strokes=strokes(2), smoothing=11, duration=3.0).demonstrations()
    for a, b in zip(plain.smooth(11).retime(3.0), found, strict=True):
        assert (a.x == b.x).all() and (a.v == b.v).all() and b.dt == 0.03


def test_an_empty_drawing_can_be_held_and_says_that_nothing_is_drawn():
    with pytest.raises(InvalidArgumentError, match="nothing is drawn"):
        Problem().demonstrations()
