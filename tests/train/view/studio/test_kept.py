"""The state of the page in its folder."""

import json

import pytest

from tests import drawn
from train.view.studio import kept


def test_what_is_kept_is_found(tmp_path):
    assert kept.read(tmp_path) is None
    kept.write(tmp_path, drawn.problem(), [tmp_path / "run", None])
    assert kept.read(tmp_path) == (drawn.problem(), [tmp_path / "run", None])


@pytest.mark.parametrize("damaged", ["", "{", "[]", "{}", '{"problem": {}, "runs": []}', '{"problem": 3}', "\x00\xff"])
def test_what_cannot_be_read_is_put_aside_and_not_lost(tmp_path, capsys, damaged):
    (tmp_path / kept.STATE).write_text(damaged, encoding="latin-1")
    assert kept.read(tmp_path) is None and not (tmp_path / kept.STATE).exists()
    assert (tmp_path / kept.UNREAD).read_text(encoding="latin-1") == damaged
    assert str(tmp_path / kept.UNREAD) in capsys.readouterr().err


@pytest.mark.parametrize("learner", [{"updates": "many"}, {"rollouts": 2.5}, {"updatse": 3}, {"runs": 0}])
def test_a_learner_that_cannot_be_shown_is_put_aside_too(tmp_path, learner):
    kept.write(tmp_path, drawn.problem(learners=[learner]), [None, None])
    assert kept.read(tmp_path) is None and (tmp_path / kept.UNREAD).is_file()


def test_it_is_plain_json(tmp_path):
    kept.write(tmp_path, drawn.problem(), [None, None])
    assert json.loads((tmp_path / kept.STATE).read_text())["problem"] == drawn.problem().to_json()
