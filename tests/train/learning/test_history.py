"""The history of a run: sums, medians, and the closing table."""

import json

import numpy as np
import pytest
import torch

from train.learning.history import History, results, table


@pytest.fixture
def history():
    """Two updates of three runs."""
    history = History(seconds=1.23456)
    for update, scale in enumerate((4.0, 2.0, 1.0)):
        terms = {"via": scale * torch.tensor([1.0, 2.0, 6.0]), "control": torch.full((3,), 0.5)}
        history.add(10 * update, terms, failed=update, forward_equivalents=12 * update)
    return history


def test_the_cost_is_the_sum_of_the_terms(history):
    assert history.cost == [[4.5, 8.5, 24.5], [2.5, 4.5, 12.5], [1.5, 2.5, 6.5]]
    assert history.terms["control"] == [[0.5] * 3] * 3
    assert (history.rollouts, history.failed, history.forward_equivalents) == ([0, 10, 20], [0, 1, 2], [0, 12, 24])


def test_results_are_plain_and_complete(history):
    record = results("via_point", {"runs": 3}, history)
    assert json.loads(json.dumps(record)) == record
    assert record["task"] == "via_point" and record["options"] == {"runs": 3}
    assert record["seconds"] == 1.235
    assert {name: record[name] for name in ("cost", "terms", "rollouts", "failed")} == {
        "cost": history.cost,
        "terms": history.terms,
        "rollouts": history.rollouts,
        "failed": history.failed,
    }


def test_the_table_of_one_run_has_no_quartiles(history):
    alone = History(cost=[[row[0]] for row in history.cost], terms={"via": [[2.0], [0.5]]})
    lines = [line.split() for line in table(alone).splitlines()]
    assert lines == [["cost", "initial", "final"], ["total", "4.5", "1.5"], ["via", "2", "0.5"]]


def test_a_run_that_failed_is_the_worst_of_the_table(history):
    history.cost[-1][0] = float("nan")
    assert table(history).splitlines()[1].split()[2:] == ["6.5", "[4.5,", "inf]"]


def test_a_history_comes_back_from_its_plain_values(history):
    assert History(**json.loads(json.dumps(vars(history)))) == history


def test_the_table_has_medians_and_quartiles_of_the_last_update(history):
    lines = [line.split("  ") for line in table(history).splitlines()]
    cells = [[cell.strip() for cell in line if cell.strip()] for line in lines]
    assert cells[0] == ["cost", "initial", "final: median", "[q1, q3]"]
    q1, q3 = np.quantile([1.5, 2.5, 6.5], [0.25, 0.75])
    assert cells[1] == ["total", "8.5", "2.5", f"[{q1:.4g}, {q3:.4g}]"]
    assert [row[0] for row in cells[1:]] == ["total", "via", "control"]
