"""A problem file where the commands take a task: learned, resumed from elsewhere, drawn, compared."""

import json
import sys
from dataclasses import replace

import pytest
import torch

from tests.tasks.sketch.drawn import FULL
from torchds import load_policy
from train.__main__ import main
from train.compare.command import Candidate, Compare
from train.learning import figures
from train.learning.learner import Learner
from train.options import options_for
from train.view.command import View


@pytest.fixture
def train(monkeypatch):
    """Runs a command in this process."""

    def run(*arguments, code=0):
        monkeypatch.setattr(sys, "argv", ["train", *map(str, arguments)])
        assert main() == code

    return run


@pytest.fixture
def problem(tmp_path):
    (tmp_path / "drawn").mkdir()
    FULL.write(tmp_path / "drawn" / "My way.json")
    return tmp_path / "drawn" / "My way.json"


@pytest.mark.slow
def test_a_problem_file_is_learned_and_resumed_from_elsewhere(train, problem, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(problem.parent)
    train("My way.json", "--updates", "2", "--logdir", tmp_path / "logs")
    (folder,) = (tmp_path / "logs" / "my_way" / "pibb").iterdir()
    assert json.loads((folder / "options.json").read_text())["task"] == str(problem)
    monkeypatch.chdir(tmp_path)
    train("drawn/My way.json", "--resume", folder, "--updates", "3")
    learner = Learner(options_for(str(problem))).learn()  # its own number of updates
    learned = load_policy(folder / "policy.pt")
    assert torch.equal(learned.A, learner.policy.A) and learned.info.units == "m"
    options = View("drawn/My way.json", policy=folder).options(folder)
    assert (options.task, options.updates) == (str(problem), 3)
    replace(FULL, samples=5 * 41).write(problem)
    train("drawn/My way.json", "--resume", folder, code=2)
    assert "it began with another policy" in capsys.readouterr().err


def test_a_file_that_is_none_is_one_line(train, tmp_path, capsys):
    train(tmp_path / "a.json", code=2)
    said = capsys.readouterr().err
    assert said.startswith("error: ") and "no such file" in said and said.count("\n") == 1


@pytest.mark.slow
def test_regions_and_walls_are_drawn_with_the_motion(problem):
    learner = Learner(options_for(str(problem), updates=1)).learn()
    for axes in (*figures.motion(learner).axes, *figures.progress(learner, learner.path).axes):
        (disc,) = (patch for patch in axes.patches if patch.get_label() == "forbidden")
        labels = [text.get_text() for text in axes.get_legend().get_texts()]
        assert tuple(disc.center) == (-0.4, -0.4) and {"forbidden", "walls", "start", "goal"} <= set(labels)


def test_what_a_file_says_for_its_own_learner_is_not_for_all_that_are_compared(problem):
    options = Compare(tasks=(str(problem),)).options(Candidate(str(problem), "cma", "trajectory"), 1.0, 2, 0)
    assert options_for(str(problem)).noise == 0.1
    assert (options.noise, options.optimizer, options.exploration, options.runs) == (None, "cma", "trajectory", 2)
