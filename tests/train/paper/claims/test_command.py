"""python -m train claims: every claim is complete, and the tables show what was measured."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from torchds.errors import InvalidArgumentError, UnknownNameError
from train.folder import Interrupted
from train.paper.claims import command as claims
from train.paper.claims import digging
from train.paper.claims.base import NOT_MEASURED, Check, Claim, verdict
from train.paper.claims.command import CLAIMS, SECTIONS, Claims
from train.paper.measured.base import learned


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_claim_is_complete_and_has_a_name_of_its_own():
    assert len(CLAIMS) == sum(len(section.CLAIMS) for section in SECTIONS)
    for name, claim in CLAIMS.items():
        assert name == claim.id and re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name)
        assert re.match(r"[3-7](\.\d)?(,|$)", claim.where)
        for sentence in (claim.says, claim.rule):
            assert sentence[0].isupper() and sentence.endswith(".") and len(sentence) > 10
        assert callable(claim.measure)


def test_the_page_has_a_row_for_every_claim_with_its_rule():
    page = (Path(__file__).parents[4] / "docs" / "claims.md").read_text().splitlines()
    rows = [line.split(" | ")[:3] for line in page if line.startswith("| `")]
    assert rows == [[f"| `{name}`", claim.where, f"{claim.says} *{claim.rule}*"] for name, claim in CLAIMS.items()]


def test_every_figure_that_says_something_has_a_claim():
    figures = {int(n) for claim in CLAIMS.values() for n in re.findall(r"Fig\. (\d+)", claim.where)}
    assert figures == {2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 16, 17}


def test_without_an_experiment_the_rows_say_how_to_get_it(tmp_path, capsys):
    rows = Claims(only=tuple(claim.id for claim in digging.CLAIMS), logdir=tmp_path).main()
    assert {verdict(row.checks) for row in rows} == {NOT_MEASURED}
    command = "python -m train digging; python -m train claims --only digging-best-uniform --runs 20 --seed 0"
    for text in (capsys.readouterr().out, (tmp_path / "claims" / "claims.md").read_text()):
        assert "not measured here" in text and command in text
    assert {row["verdict"] for row in read(tmp_path / "claims" / "claims.csv")} == {NOT_MEASURED}


@pytest.fixture
def two_updates(monkeypatch):
    """Two updates, whatever the task says."""
    monkeypatch.setattr("train.learning.learner.n_updates", lambda *_: 2)
    learned.cache_clear()
    yield
    learned.cache_clear()


@pytest.mark.slow
def test_two_claims_are_measured_and_all_tables_agree(two_updates, tmp_path, capsys):
    names = ("pibb-below-pi2", "noise-within-half")
    kept = tmp_path / "docs" / "claims.md"
    rows = Claims(only=names, runs=3, logdir=tmp_path, keep=kept).main()
    assert [row.claim.id for row in rows] == list(names)
    page = kept.read_text()
    assert page == (tmp_path / "claims" / "claims.md").read_text()
    assert "python -m train claims --only pibb-below-pi2 noise-within-half --runs 3 --seed 0" in page
    assert "torch" in page and re.search(r"on \d{4}-\d\d-\d\d with", page) and "this is a trial" in page
    records, shown = read(tmp_path / "claims" / "claims.csv"), capsys.readouterr().out
    assert len(records) == sum(len(row.checks) for row in rows) == 4
    for name in names:
        mine = [record for record in records if record["id"] == name]
        (line,) = [line for line in page.splitlines() if line.startswith(f"| `{name}`")]
        assert {record["verdict"] for record in mine} == {line.rsplit("**", 2)[1]}
        for record in mine:
            assert record["check"] in line and record["check"] in shown
            assert not record["p"] or f"δ = {record['delta']}, p = {record['p']}" in line
            assert record["command"] == f"python -m train claims --only {name} --runs 3 --seed 0"
            assert None not in record and record["says"] and record["rule"]
        assert line.count("<br>") == len(mine) - 1


@pytest.fixture
def made_up(monkeypatch):
    """Two claims, the second of which is interrupted as often as `stop` says; returns what was measured."""
    asked, stop = [], []

    def first(setting):
        asked.append(("first", setting.runs, setting.seed))
        return [Check("one | two", np.bool_(True).item(), 3, 0.5, 0.25)]

    def second(setting):
        if stop:
            raise stop.pop()
        asked.append(("second", setting.runs, setting.seed))
        return [Check("three", False, 3)]

    claim = Claim("first", "3", "A sentence.", "A rule.", first)
    monkeypatch.setattr(claims, "CLAIMS", {"first": claim, "second": replace(claim, id="second", measure=second)})
    return asked, stop


def test_an_interrupted_command_goes_on_where_it_was(made_up, tmp_path):
    asked, stop = made_up
    stop.append(KeyboardInterrupt())
    with pytest.raises(Interrupted, match="the same command continues"):
        Claims(logdir=tmp_path).main()
    assert asked == [("first", 20, 0)]
    first = Claims(logdir=tmp_path).main()
    assert asked == [("first", 20, 0), ("second", 20, 0)]
    assert Claims(logdir=tmp_path).main() == first  # from what is kept
    assert len(asked) == 2
    assert "one \\| two" in (tmp_path / "claims" / "claims.md").read_text()


def test_other_options_and_other_code_are_measured_again(made_up, tmp_path, monkeypatch):
    asked, _ = made_up
    for options in ({}, {"runs": 5}, {"seed": 1}):
        Claims(only=("first",), logdir=tmp_path, **options).main()
    assert asked == [("first", 20, 0), ("first", 5, 0), ("first", 20, 1)]
    monkeypatch.setattr(claims, "source", lambda: "changed")
    Claims(only=("first",), logdir=tmp_path, seed=1).main()
    assert len(asked) == 4


def test_what_cannot_be_measured_is_refused_before_anything_is_made(tmp_path):
    with pytest.raises(UnknownNameError, match=r"^unknown claim 'trade-of'\. Did you mean 'trade-off'"):
        Claims(only=("trade-of",), logdir=tmp_path / "new").main()
    with pytest.raises(InvalidArgumentError, match="--runs has to be at least 1, got 0"):
        Claims(runs=0, logdir=tmp_path / "new").main()
    assert not (tmp_path / "new").exists()
