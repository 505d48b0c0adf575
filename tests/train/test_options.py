import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

import tasks
from tasks.constrained_reaching import ConstrainedReaching
from tests.tasks.sketch.drawn import FULL
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from train.compare.command import Candidate, Compare
from train.compare.sweep import spec as sweep
from train.compare.sweep.table import rows
from train.folder import RunFolder, check_identity
from train.learning import run
from train.options import options_class, options_for, usual_values


class Own(tasks.ViaPoint):
    """A task of one's own, with fields of many types."""

    name = "own_for_options"
    gains: tuple[float, float] = (1.0, 2.0)
    data: Path = Path("data.csv")
    other: Path | None = None
    limit: float = math.inf
    seed: int = 0


class Need(tasks.ViaPoint):
    """A task with a field that has to be said."""

    name = "need_for_options"
    height: float


OWN = f"{__name__}:Own"


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


@pytest.mark.parametrize(
    "given", [{}, {"gains": (3.0, -math.inf), "data": Path("a/b.csv"), "other": Path("c"), "limit": 2.0}]
)
def test_options_of_a_task_of_ones_own_come_back_from_json_and_are_those_of_the_run(given, tmp_path):
    options = options_for(OWN, runs=2, **given)
    said = json.loads(json.dumps(options.to_json(), allow_nan=False))
    assert said == options.to_json()
    assert type(options).from_json(said) == options
    check_identity(tmp_path, {"task": options.task, "options": said}, options)
    check_identity(tmp_path, {"task": options.task, "options": {**said, "gains": options.gains}}, options)


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"scale": 3.0}, r"the field scale of Mine has the name of an option of every run, which is 1\.0 .* and not 3\.0"),
        ({"noise": 0.1}, "the field noise of Mine .* which is None if nothing is said, and not 0.1; give the field another"),
    ],
)  # fmt: skip
def test_a_field_that_would_lose_its_default_to_an_option_of_every_run_is_refused(field, words, monkeypatch):
    (name, usual), *_ = field.items()
    made = type("Mine", (Own,), {"__annotations__": {name: float}, "__module__": __name__, **field})
    monkeypatch.setitem(globals(), "Mine", made)
    with pytest.raises(InvalidArgumentError, match=words):
        options_class(f"{__name__}:Mine")
    made.defaults = {name: usual}
    assert getattr(options_for(f"{__name__}:Mine"), name) == usual


def test_an_option_without_a_default_is_one_of_the_run_and_has_to_be_said(tmp_path):
    spec = f"{__name__}:Need"
    low, high = options_for(spec, height=1.0), options_for(spec, height=2.0)
    assert {**usual_values(low), "height": 1.0} == low.to_json()
    assert run.telling(low)["height"] == 1.0 and sweep.name(low) != sweep.name(high)
    assert run.merged(replace(low, updates=7), low, RunFolder(tmp_path), None).updates == 7
    with pytest.raises(InvalidArgumentError, match=r"cannot take --height 2\.0 \(it was 1\.0\)"):
        run.merged(high, low, RunFolder(tmp_path), None)
    check_identity(tmp_path, {"task": spec, "options": low.to_json()}, low)
    with pytest.raises(FileError, match=r"another run: height 2\.0 there and 1\.0 here"):
        check_identity(tmp_path, {"task": spec, "options": high.to_json()}, low)
    (tmp_path / "both.toml").write_text(f'task = "{spec}"\nheight = [1.0, 2.0]')
    jobs = sweep.read(tmp_path / "both.toml")
    found = rows(jobs, {}, {job.name: "no time" for job in jobs})
    assert [row.label for row in found] == ["pibb height=1.0", "pibb height=2.0"]
    for make in (tasks.make, options_for, lambda task: type(low).from_json({})):
        with pytest.raises(InvalidArgumentError, match=r"needs .*height, which has no default: say it, or give it one"):
            make(spec)
    with pytest.raises(InvalidArgumentError, match="needs the option height"):
        Compare(tasks=(spec,)).options(Candidate(spec, "pibb", "plain"), 1.0, 1, 0)


def test_defaults_of_a_task_are_read_as_options_are(monkeypatch):
    monkeypatch.setitem(
        globals(), "Mine", type("Mine", (Own,), {"__module__": __name__, "defaults": {"logdir": "there"}})
    )
    assert options_for(f"{__name__}:Mine").logdir == Path("there")
