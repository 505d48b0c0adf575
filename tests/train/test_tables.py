"""Tables in Markdown and for the terminal, read back cell by cell."""

import csv
import re

import pytest

from train.tables import aligned, markdown, write_csv


def cells(line):
    """The cells of a line of a Markdown table, as a reader's program splits it."""
    assert line.startswith("| ") and line.endswith(" |")
    return [cell.replace("\\|", "|") for cell in re.split(r"(?<!\\) \| ", line[2:-2])]


def test_a_markdown_table_has_the_header_a_rule_and_the_rows():
    head, rule, *rows = markdown(("name", "a|b"), [["x", "1"], ["p | q", ""]]).splitlines()
    assert cells(head) == ["name", "a|b"]
    assert cells(rule) == ["---", "---"]
    assert [cells(row) for row in rows] == [["x", "1"], ["p | q", ""]]


def test_columns_may_be_aligned_from_the_first_on():
    rule = markdown(("a", "b", "c"), [], "lr").splitlines()[1]
    assert cells(rule) == ["---", "---:", "---"]


def test_a_table_without_rows_is_its_header():
    assert markdown(("a", "b"), []) == "| a | b |\n| --- | --- |"
    assert aligned(("a", "bb"), []) == "a  bb"


def test_numbers_stand_right_and_text_left_for_the_terminal():
    text = aligned(
        ("cost", "initial", "n", "range"), [("total", 1234.5678, 3, "[1, 2]"), ("goal", 0.5, 1200, "[0, 1]")]
    )
    assert text.splitlines() == [
        "cost   initial     n  range",
        "total     1235     3  [1, 2]",
        "goal       0.5  1200  [0, 1]",
    ]
    assert all(line == line.rstrip() for line in aligned(("a", "b"), [("x", "y"), ("x", "yyy")]).splitlines())


def test_a_row_with_a_cell_too_few_is_found_out():
    with pytest.raises(IndexError):
        aligned(("a", "b"), [("x",)])


def test_a_csv_table_is_read_back_and_replaces_the_old_one(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    rows = [["x, y", 'say "no"'], [0.1, "two\nlines"]]
    write_csv(path, ["name", "ü"], rows)
    with path.open(newline="", encoding="utf-8") as file:
        assert list(csv.reader(file)) == [["name", "ü"], rows[0], ["0.1", "two\nlines"]]
    assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]
