"""Runs and tasks that are kept: by what they are found, and what is the same."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.tasks.sketch.drawn import FULL
from train.folder import check_identity
from train.learning import kept
from train.learning.kept import key
from train.options import RunOptions, options_for


class Counter:
    """A task that goes on from trial to trial."""

    def __init__(self):
        self.n = 0

    def state_dict(self):
        return {"n": self.n}

    def load_state_dict(self, state):
        self.n = state["n"]


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(kept, "_made", {})
    monkeypatch.setattr(RunOptions, "make_task", lambda options: Counter())


@pytest.mark.usefixtures("made")
def test_a_task_is_the_same_one_as_if_new():
    task = kept.made(options_for("via_point"))
    task.n = 5
    assert kept.made(options_for("via_point", seed=3, optimizer="cma")) is task and task.n == 0


@pytest.mark.usefixtures("made")
@pytest.mark.parametrize("other", [{"shape": "P"}, {"device": "cuda"}, {"convention": "released"}])
def test_other_options_have_another_task(other):
    assert kept.made(options_for("via_point", **other)) is not kept.made(options_for("via_point"))


MINE = "import tasks\nclass Mine(tasks.ViaPoint):\n    pass\n"


@pytest.mark.parametrize("what", ["task", "optimizer", "exploration", "mixture", "problem", "helper"])
def test_runs_are_known_by_what_their_files_hold_and_not_by_where_they_stand(what, tmp_path, monkeypatch):
    def named(folder, text):
        (tmp_path / folder).mkdir(exist_ok=True)
        monkeypatch.chdir(tmp_path / folder)
        if what == "problem":
            replace(FULL, unit=text).write("mine.json")
            return key(mine := options_for("mine.json", seed=3)), mine
        file = tmp_path / folder / ("mine.npz" if what == "mixture" else "mine.py")
        file.write_text(f"{MINE}# {text}" if what != "helper" else f"import beside_mine\n{MINE}")
        file.with_name("beside_mine.py").write_text(f"# {text}" if what == "helper" else "")
        place = Path(file.name) if what == "mixture" else f"{file}:Mine"
        named = "mixture" if what == "mixture" else "exploration" if what == "exploration" else "optimizer"
        mine = options_for("mine.py:Mine") if what == "task" else options_for("via_point", **{named: place})
        return key(mine), mine

    (one, first), (same, elsewhere), (other, _) = named("a", "one"), named("b", "one"), named("c", "two")
    assert one == same != other
    check_identity(tmp_path, {"task": first.task, "options": first.to_json()}, elsewhere)
    assert named("a", "two")[0] == other


def test_the_key_of_what_names_no_file_stays_what_it_was():
    """That of 0.2.0: the digest of task and options that are not as usual."""
    assert key(options_for("via_point", seed=2, optimizer="cma", logdir=Path("elsewhere"))) == "64306a20104977ca"
