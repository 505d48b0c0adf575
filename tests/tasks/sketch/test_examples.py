"""The problem files that come with the project."""

from dataclasses import replace
from statistics import median

import pytest

from tasks.sketch import Problem, examples
from tasks.via_point import ViaPoint
from train.learning.learner import Learner
from train.options import options_for

RUNS = 4


def test_there_are_five_as_a_person_would_have_written_them(tmp_path):
    assert list(examples()) == ["an_s", "around_a_wall", "forbidden_region", "paper_n", "point_mass_in_a_field"]
    for name, path in examples().items():
        problem = Problem.read(path)
        problem.write(tmp_path / path.name)
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), name
        assert len(problem.strokes) == 3 and path.stat().st_size < 6000
        assert options_for(str(path)).name == name


@pytest.mark.slow
@pytest.mark.parametrize("name", examples())
@pytest.mark.parametrize("which", [0, 1])
def test_each_learner_of_each_learns(name, which, tmp_path):
    """The median over four runs of the cost of the policy without noise, before and after all updates of the learner."""
    problem = Problem.read(examples()[name])
    if which >= len(problem.learners):
        pytest.skip("it has one learner")
    replace(problem, learners=[problem.learners[which]]).write(tmp_path / f"{name}.json")
    history = Learner(options_for(str(tmp_path / f"{name}.json"), runs=RUNS)).learn().history
    first, last = median(history.cost[0]), median(history.cost[-1])
    shortest = 1.83 if name == "around_a_wall" else 0.0  # the way around the wall, which no policy saves
    assert last - shortest < 0.3 * (first - shortest), (first, last)
    assert all(c < first for c in history.cost[-1])


def test_the_n_of_the_paper_is_the_task_via_point():
    problem, task = Problem.read(examples()["paper_n"]), ViaPoint()
    assert (problem.start, problem.via_points, problem.unit) == (
        task.setup.start,
        task.setup.via_points,
        task.setup.unit,
    )
    assert (problem.duration, problem.samples) == (task.setup.duration, task.motion().n_steps + 1)
    assert problem.learners[0] == {
        "optimizer": "pibb",
        "exploration": "homogeneous",
        "noise": 0.1,
        "updates": 50,
        "runs": 4,
    }
    for drawn, recorded in zip(problem.demonstrations().resample(200), task.demonstrations.resample(200), strict=True):
        assert (drawn.x - recorded.x).norm(dim=-1).max() < 0.2  # of 11: sixty points, rounded, of a thousand
