"""The report of a comparison: tables, order, curves and files, from outcomes that are known."""

import csv

import numpy as np
import pytest

from tests.colours import closest
from train.compare.report import (
    COLORS,
    HEAD,
    Outcome,
    choices,
    colors,
    curves,
    dashes,
    number,
    page,
    reference_level,
    table,
    write,
)


def row(label, cost, rollouts=(0, 10, 20)):
    return Outcome("p", label, {"cost": cost, "rollouts": list(rollouts)})


def test_rollouts_to_a_level_are_those_of_the_first_update_whose_median_is_there():
    curve = row("a", [[9.0, 9.0, 9.0], [1.0, 4.0, 5.0], [1.0, 2.0, 9.0]])
    assert [curve.reaches(level) for level in (9.0, 4.0, 3.0, 1.9)] == [0, 10, 20, None]
    assert reference_level([curve, row("pibb", [[9.0], [3.0], [2.5]])]) == 2.5
    assert reference_level([curve]) is None


def test_runs_that_went_astray_count_as_the_worst():
    q1, median, q3 = row("a", [[1.0, float("nan"), 2.0, float("inf"), 3.0]], [0]).quartiles()[:, 0]
    assert (q1, median) == (2.0, 3.0)
    assert q3 == np.inf


def outcome(label, final, **given):
    """Three runs of one median, with all that a record has."""
    record = {
        "cost": [[9.0] * 3, [final - 1, final, final + 2]],
        "rollouts": [0, 10],
        "forward_equivalents": [0, 40],
        "failed": [0, 2],
        "seconds": 3.4,
    }
    return Outcome(given.pop("problem", "p"), label, record, **given)


def lines(text):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]


def test_the_table_has_the_lowest_cost_first_and_what_was_refused_last():
    rows = [
        outcome("pibb", 5.0, factor=1.0),
        outcome("adam", 3.0, gradient=True, random=False, factor=0.1),
        Outcome("p", "cma", refused="no such package"),
    ]
    text = table(rows)
    head, _, *body = lines(text)
    assert tuple(head) == HEAD
    assert [line[0] for line in body] == ["adam", "pibb", "cma"]
    named = [dict(zip(head, line, strict=True)) for line in body]
    assert named[0] | {"gradients": "yes", "runs": "1, deterministic", "to PI^BB's final": "10"} == named[0]
    assert named[1] | {"final median": "5", "q1": "4.5", "q3": "6", "failed": "2", "runs": "3"} == named[1]
    assert set(list(named[2].values())[1:]) == {"—"}
    assert "- cma: no such package" in text


def test_levels_are_reached_never_or_unknown():
    head, _, *body = lines(table([outcome("pibb", 2.0), outcome("nes", 4.0)]))
    at = head.index("to PI^BB's final")
    assert [line[at] for line in body] == ["10", "never"]
    assert lines(table([outcome("nes", 4.0)]))[2][at] == "—"


def test_choices_name_what_was_tuned_and_chosen():
    tuned = outcome("pibb", 2.0, factor=0.1, tuned={0.1: 2.5, 1.0: float("inf")})
    head, _, line = lines(choices([tuned, outcome("cma", 1.0)]))
    assert head == ["problem", "optimizer", "× 0.1", "× 1", "chosen"]
    assert line == ["p", "pibb", "2.5", "∞", "0.1"]
    assert choices([outcome("pibb", 2.0)]) == "No tuning: one factor was given."


@pytest.mark.parametrize(
    ("value", "text"), [(1234.5, "1.23e+03"), (0.12345, "0.123"), (float("inf"), "∞"), (np.nan, "∞")]
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_an_optimizer_keeps_its_colour_in_all_panels_and_others_get_one_each():
    rows = [outcome(name, 1.0) for name in ("pibb", "pibb, trajectory", "mine", "ppo, added")]
    found = colors(rows)
    assert set(found) == {"pibb", "mine", "ppo"}
    assert len(set(found.values())) == 3


@pytest.mark.slow
def test_curves_have_a_panel_for_each_problem_and_kind():
    rows = [outcome("pibb", 2.0), outcome("pibb, trajectory", 1.0), outcome("pibb", 3.0, problem="q")]
    figure = curves([*rows, Outcome("q", "cma", refused="gone")])
    assert [axes.get_title() for axes in figure.axes] == [
        "p: plain",
        "p: along the motion",
        "q: plain",
        "q: along the motion",
    ]
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "pibb"]
    assert line.get_ydata().tolist() == [9.0, 2.0]


@pytest.mark.parametrize(
    ("final", "scale"),
    [((2.0, 1.0), "log"), ((-3.0, 1.0), "linear"), ((0.0, 1.0), "linear"), ((float("inf"), 1.0), "log")],
)
def test_a_problem_has_one_scale_and_logarithms_only_where_all_medians_are_positive(final, scale):
    rows = [outcome("pibb", final[0]), outcome("pibb, trajectory", final[1]), outcome("pibb", 1.0, problem="q")]
    figure = curves(rows)
    assert [axes.get_yscale() for axes in figure.axes] == [scale, scale, "log", "log"]
    low, high = figure.axes[0].get_ylim()
    shown = [value for value in (*final, 9.0) if np.isfinite(value)]
    assert low < min(shown) and max(shown) < high < 4 * max(shown) and figure.axes[1].get_ylim() == (low, high)


def test_rewards_alone_have_curves_too():
    rewards = {"cost": [[-1.0] * 3, [-5.0] * 3], "rollouts": [0, 10]}
    (axes,) = curves([Outcome("p", "pibb", rewards)]).axes
    assert axes.get_yscale() == "linear" and axes.get_ylim()[0] < -5.0 < -1.0 < axes.get_ylim()[1]


@pytest.mark.parametrize("kind", ["-", "-.", "--", ":"])
def test_the_colour_blind_tell_the_rows_of_one_kind_of_line_apart(kind):
    gradient = ("adam", "sgd", "lbfgs")
    rows = [Outcome("p", name, gradient=name in gradient) for name in (*COLORS, "own", "other", "third", "fourth")]
    shown = [row.label for row in rows if dashes(row) == kind]
    assert {"-": "cobyqa", "-.": "pi2", "--": "adam", ":": "own"}[kind] in shown
    assert closest([colors(rows)[name] for name in shown]) >= (15.0,) if len(shown) > 1 else shown == ["pi2"]


OPTIONS = {"noise_std": 0.0, "factors": (0.1, 1.0), "tuning_runs": 5}


def test_the_page_has_every_problem_and_says_where_costs_are_noisy():
    rows = [outcome("pibb", 2.0), outcome("pibb", 3.0, problem="q")]
    text = page(rows, OPTIONS, {"torch": "9.9"})
    assert text.index("## p\n") < text.index("## q\n") < text.index("## Tuning")
    assert "torch 9.9" in text and "normal noise" not in text
    assert "normal noise of 0.3 times" in page(rows, OPTIONS | {"noise_std": 0.3}, {})
    assert "was tuned by one factor over the grid 0.1, 1," in text
    once = page(rows, OPTIONS | {"factors": (1.0,)}, {})
    assert "tuned" not in once and once.index("## Tuning") < once.index("No tuning: one factor was given.")
    assert "## Tuning" not in page(rows, {"sweep": "mine.toml"}, {})


@pytest.mark.slow
def test_all_files_are_written_and_agree(tmp_path):
    rows = [outcome("pibb", 2.0, factor=1.0), Outcome("p", "cma", refused="no such package")]
    text = write(tmp_path, rows, OPTIONS, {})
    assert (tmp_path / "report.md").read_text() == text
    with (tmp_path / "table.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [(row["optimizer"], row["final median"], row["refused"]) for row in found] == [
        ("pibb", "2", ""),
        ("cma", "—", "no such package"),
    ]
    with (tmp_path / "curves.csv").open(newline="") as file:
        assert [float(row["median"]) for row in csv.DictReader(file)] == [9.0, 2.0]
    assert (tmp_path / "curves.png").stat().st_size > 5000
    assert list((tmp_path / "000").glob("events*"))
