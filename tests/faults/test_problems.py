"""Problem files with whatever in them: refused in our words, or a problem that comes back as it was."""

import json
from dataclasses import replace

import pytest
from hypothesis import strategies as st

from tasks.sketch import Problem, Sketch
from tests.faults.cases import fuzz
from tests.tasks.sketch.drawn import FULL, strokes
from torchds.errors import TorchdsError


def moving(rows):
    """Rows as a stroke has them: the times rise, and it goes somewhere."""
    return [(t + i, x1 + 1e4 * i, x2) for i, (t, x1, x2) in enumerate(sorted(rows))]


NUMBERS = st.floats(-1e3, 1e3)
PAIRS = st.tuples(NUMBERS, NUMBERS)
ROWS = st.tuples(st.floats(0, 100), NUMBERS, NUMBERS)
STROKES = st.lists(st.lists(ROWS, min_size=2, max_size=6).map(moving), max_size=3)
REGIONS = st.fixed_dictionaries({"center": PAIRS, "radius": st.floats(1e-3, 10)})
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
PROBLEMS = st.builds(
    Problem,
    strokes=STROKES,
    samples=st.integers(10, 200),
    duration=st.none() | st.floats(0.1, 1e3),
    goal=st.none() | PAIRS,
    via_points=st.lists(PAIRS, max_size=3),
    walls=st.lists(st.tuples(PAIRS, PAIRS), max_size=2),
    regions=st.lists(REGIONS, max_size=2),
    body=st.none() | st.just({}) | st.builds(lambda force: {"field": "constant", "force": force}, PAIRS),
)
SMALL = json.loads(json.dumps(replace(FULL, strokes=strokes(1, 4)).to_json()))


def places(value, path=()):
    """The ways to all values within a plain one."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path] + [place for key, each in items for place in places(each, (*path, key))]


def damaged(way, new):
    """The values of a file with another one in one place."""
    *before, last = way
    values = json.loads(json.dumps(SMALL))
    inner = values
    for key in before:
        inner = inner[key]
    inner[last] = new
    return values


@fuzz(problem=PROBLEMS)
def test_any_problem_comes_back_from_json(problem):
    assert Problem.from_json(json.loads(json.dumps(problem.to_json()))) == problem


@fuzz(60, way=st.sampled_from(places(SMALL)[1:]), new=PLAIN)
def test_a_wrong_value_is_refused_in_our_words_or_is_a_problem(way, new):
    try:
        problem = Problem.from_json(damaged(way, new))
    except TorchdsError as error:
        assert len(str(error)) < 600
    else:
        assert Problem.from_json(json.loads(json.dumps(problem.to_json()))) == problem


@fuzz(40, at=st.integers(0, 10**6), byte=st.integers(0, 255))
def test_a_file_with_a_wrong_byte_is_refused_in_our_words_or_is_a_problem(tmp_path, at, byte):
    FULL.write(tmp_path / "a.json")
    content = bytearray((tmp_path / "a.json").read_bytes())
    content[at % len(content)] = byte
    (tmp_path / "a.json").write_bytes(content)
    try:
        problem = Problem.read(tmp_path / "a.json")
    except TorchdsError as error:
        assert len(str(error)) < 600
    else:
        assert Problem.from_json(problem.to_json()) == problem


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@fuzz(5, problem=PROBLEMS)
def test_a_problem_of_any_numbers_is_tried_or_refused_in_our_words(problem):
    try:
        task = Sketch.of(problem)()
        path = task.rollout(task.policy())
        assert path.x.shape[-1] == 2 and all(term.shape == () for term in task.cost_terms(path).values())
    except TorchdsError as error:
        assert len(str(error)) < 600
