"""The claims as tables: CSV, Markdown and lines for the terminal show the same rows."""

import csv

import pytest

from train.paper.claims import report
from train.paper.claims.base import Check, Claim
from train.paper.claims.report import Judged


@pytest.fixture
def rows():
    claim = Claim("one", "3, Fig. 2", "It is so.", "It falls.", lambda setting: [])
    checks = [Check("cost: 3 | 2", True, 20, -0.75, 0.002), Check("cases: 3 of 4", False, 4)]
    return [Judged(claim, checks, "again one"), Judged(claim, [], "again two")]


def test_a_row_has_a_record_for_each_check_or_one_that_says_there_is_none(rows):
    first, second = report.rows_of(rows[0])
    assert (first["check"], first["holds"], first["n"], first["delta"], first["p"]) == (
        "cost: 3 | 2",
        "yes",
        "20",
        "-0.75",
        "2.0e-03",
    )
    assert (second["holds"], second["delta"], second["p"]) == ("no", "", "")
    assert first["verdict"] == second["verdict"] == "held in part"
    (none,) = report.rows_of(rows[1])
    assert none["verdict"] == "not measured here" and none["command"] == "again two" and "check" not in none


def test_the_csv_file_is_read_back(rows, tmp_path):
    report.write_csv(tmp_path / "claims.csv", rows)
    with (tmp_path / "claims.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert tuple(found[0]) == report.COLUMNS
    assert [record["check"] for record in found] == ["cost: 3 | 2", "cases: 3 of 4", ""]


def test_a_check_in_one_line_has_its_mark_and_its_statistics(rows):
    held, failed = (report.line(check) for check in rows[0].checks)
    assert held == "+ cost: 3 | 2; δ = -0.75, p = 2.0e-03" and failed == "− cases: 3 of 4"


def test_the_tally_counts_verdicts_in_one_order(rows):
    assert report.tally([rows[1], *rows]) == "1 held in part, 2 not measured here"


@pytest.mark.parametrize(("runs", "warned"), [(6, True), (7, False), (20, False)])
def test_too_few_runs_are_called_a_trial(rows, runs, warned):
    assert 0.5**report.SMALLEST < 0.01 < 0.5 ** (report.SMALLEST - 1)
    for text in (report.terminal(rows, runs), report.page(rows, runs, "again")):
        assert ("this is a trial" in text) == warned


def test_the_page_has_one_line_for_each_claim_and_counts_the_tests(rows):
    page = report.page(rows, 20, "again")
    table = [line for line in page.splitlines() if line.startswith("| `one`")]
    assert len(table) == 2 and "cost: 3 \\| 2" in table[0] and "<br>" in table[0] and "`again two`" in table[1]
    assert "There are 1 tests on this page" in page and "Made by `again` on" in page


def test_the_terminal_says_how_to_measure_what_is_not_there(rows):
    text = report.terminal(rows, 20)
    assert "    measure it with: again two" in text and text.endswith("1 held in part, 1 not measured here.")
