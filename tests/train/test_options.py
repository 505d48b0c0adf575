import json
from dataclasses import replace

import pytest

from tasks.constrained_reaching import ConstrainedReaching
from tests.tasks.sketch.drawn import FULL
from torchds.errors import InvalidArgumentError, UnknownNameError
from train.options import options_class, options_for


def problem(tmp_path, **learner):
    replace(FULL, learners=[learner]).write(tmp_path / "a.json")
    return str(tmp_path / "a.json")


def test_a_task_says_what_is_taken_if_nothing_else_is_said():
    assert ConstrainedReaching.defaults == {"exploration": "stable"}
    assert options_for("constrained_reaching").exploration == "stable"
    assert options_for("constrained_reaching", exploration="gaussian").exploration == "gaussian"
    assert options_for("via_point").exploration == "homogeneous"


def test_the_first_learner_of_a_problem_file_is_that_of_the_command(tmp_path):
    spec = problem(tmp_path, optimizer="surrogate", exploration="trajectory", noise=0.2, updates=7, runs=3)
    options = options_for(spec, updates=9)
    said = (options.optimizer, options.exploration, options.noise, options.updates, options.runs)
    assert said == ("surrogate", "trajectory", 0.2, 9, 3)
    assert (options.name, options.task, options_class(spec).task) == ("a", spec, spec)
    assert type(options).from_json(json.loads(json.dumps(options.to_json()))) == options


def test_a_problem_file_has_its_whole_path_in_the_options(tmp_path, monkeypatch):
    spec = problem(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert options_for("a.json").task == spec


@pytest.mark.parametrize(
    ("learner", "error", "words"),
    [
        ({"optimiser": "pibb"}, UnknownNameError, r"unknown option of a run 'optimiser'. Did you mean 'optimizer'"),
        ({"updates": 1.5}, InvalidArgumentError, r"the option updates cannot be 1\.5; it has to be a whole number or nothing"),
        ({"decay": "quick"}, InvalidArgumentError, "the option decay cannot be 'quick'"),
        ({"resume": "there"}, UnknownNameError, "unknown option of a run 'resume'"),
    ],
)  # fmt: skip
def test_an_option_of_a_learner_that_cannot_be_is_refused_when_the_options_are_made(tmp_path, learner, error, words):
    with pytest.raises(error, match=words):
        options_class(problem(tmp_path, **learner))


def test_an_unknown_optimizer_of_a_learner_is_refused_too(tmp_path):
    with pytest.raises(UnknownNameError, match=r"unknown optimizer 'pib'. Did you mean 'pibb'"):
        options_for(problem(tmp_path, optimizer="pib"))
