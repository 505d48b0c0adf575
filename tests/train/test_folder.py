"""The folder of a run: what it has, what it lacks, and that readers never see half a file."""

import json
from pathlib import Path

import pytest
import torch

import tasks
import torchds
from torchds.errors import InvalidArgumentError
from train.folder import CHECKPOINT, OPTIONS, POLICY, RESULTS, RunFolder, say_versions, versions
from train.learning.history import History, results
from train.options import options_for


def test_new_folders_never_meet(tmp_path, monkeypatch):
    monkeypatch.setattr("train.folder.time.strftime", lambda form: "now")
    paths = [RunFolder.new(tmp_path, "via_point", "pibb", 3).path for _ in range(3)]
    names = ["now-3", "now-3.1", "now-3.2"]
    assert paths == [tmp_path / "via_point" / "pibb" / name for name in names]
    assert all(path.is_dir() for path in paths)


@pytest.mark.parametrize(
    "options",
    [
        options_for("via_point", shape="P", runs=7, mixture=Path("a.npz"), updates=3),
        options_for("divergent_field", learn="motion", initial_stiffness=2.5),
    ],
)
def test_options_come_back_as_they_were_begun_with(options, tmp_path):
    folder = RunFolder(tmp_path / "deep" / "run")
    folder.begin(options.task, options.to_json())
    assert folder.has(OPTIONS)
    again = folder.options()
    assert type(again) is type(options)
    assert again == options
    assert json.loads((folder.path / OPTIONS).read_text())["task"] == options.task


class Counter:
    """A learner that knows one number."""

    def __init__(self, **options):
        self.options, self.history = options_for("via_point", **options), History(cost=[[1.0]])
        self.n = torch.tensor(0)

    def state_dict(self):
        return {"n": self.n}

    def load_state_dict(self, state):
        self.n = state["n"]


def test_a_learner_comes_back_from_its_checkpoint_and_stays_new_without_one(tmp_path):
    folder, learner = RunFolder(tmp_path), Counter()
    folder.restore(learner)
    assert int(learner.n) == 0
    learner.n += 5
    folder.save_checkpoint(learner, events=7)
    again = Counter()
    assert folder.restore(again) == 7
    assert int(again.n) == 5
    folder.drop_checkpoint()
    folder.drop_checkpoint()  # twice is fine
    assert not folder.has(CHECKPOINT)


@pytest.mark.slow
def test_results_and_policy_come_back(tmp_path):
    folder = RunFolder(tmp_path)
    record = results("via_point", {"seed": 3}, History(cost=[[1.5, 2.5]], terms={"goal": [[1.5, 2.5]]}))
    folder.write_results(record)
    task = tasks.make("via_point")
    folder.save_policy(policy := task.policy().expand(2), task)
    assert folder.results() == record
    assert torch.equal(folder.policy().A, policy.A)
    assert folder.policy().info[2:5] == (("x1", "x2"), task.scene().unit, task.motion().dt)
    assert sorted(path.name for path in tmp_path.iterdir()) == [POLICY, RESULTS]


def test_what_is_missing_is_named_with_the_option_that_asked_for_it(tmp_path):
    folder = RunFolder(tmp_path / "x", "--resume")
    with pytest.raises(
        InvalidArgumentError, match=r"--resume .*x: no options.json there; give the folder of a run, below"
    ):
        folder.options()
    with pytest.raises(InvalidArgumentError, match=r"no results.json there; give the folder of a finished run"):
        folder.results()
    with pytest.raises(InvalidArgumentError, match=r"no policy.pt there"):
        folder.policy()
    folder.begin("via_point", {})
    with pytest.raises(InvalidArgumentError, match=r"x: no results.json, policy.pt there"):
        folder.require(OPTIONS, RESULTS, POLICY)
    folder.require(OPTIONS)


def test_versions_name_what_results_depend_on():
    assert {"python", "machine", "torchds", "torch", "numpy"} <= set(versions())
    assert versions()["torchds"] == torchds.__version__
    assert versions()["torch"] == torch.__version__.split("+")[0] or versions()["torch"] == torch.__version__


def test_a_checkpoint_of_another_backend_is_said(monkeypatch, capsys):
    monkeypatch.setenv("TORCHDS_BACKEND", "eager")
    say_versions(Path("a.pt"), versions())
    assert not capsys.readouterr().err
    say_versions(Path("a.pt"), {**versions(), "roll-outs": "fused"})
    assert "a.pt was written with roll-outs fused, here eager: last digits may differ" in capsys.readouterr().err
