"""Which runs of a sweep are one row, and what tables call it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.tasks.sketch.drawn import FULL
from train.compare.sweep import spec
from train.compare.sweep.table import rows

OPTIMIZER = "from torchds.optim import PIBB\nclass Winner(PIBB):\n    pass\n"
EXPLORATION = "from torchds.exploration import Gaussian\nclass Winner(Gaussian):\n    pass\n"


def record(*costs):
    return {"rollouts": [0], "cost": [list(costs)], "terms": {}, "failed": [0], "seconds": 1.0}


@pytest.fixture
def table(tmp_path, monkeypatch):
    """The rows of a sweep whose n-th job, from 1, has cost n."""
    monkeypatch.chdir(tmp_path)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "opt.py").write_text(f"{OPTIMIZER}# {folder}")
        (tmp_path / folder / "noise.py").write_text(f"{EXPLORATION}# {folder}")
        replace(FULL, learners=({},), unit=folder).write(tmp_path / folder / "p.json")

    def make(text, cost=float):
        (tmp_path / "mine.toml").write_text(text)
        jobs = spec.read(tmp_path / "mine.toml")
        return rows(jobs, {job.name: record(cost(n)) for n, job in enumerate(jobs, 1)}, {})

    return make


def shown(found):
    return [(row.problem, row.label, row.record["cost"][0]) for row in found]


def test_methods_of_one_short_name_are_rows_of_their_own_by_their_whole_names(table, tmp_path):
    found = table('task = "via_point"\noptimizer = ["a/opt.py:Winner", "b/opt.py:Winner"]\nseeds = 2')
    assert shown(found) == [
        ("via_point-N", f"{tmp_path}/a/opt.py:Winner", [1.0, 2.0]),
        ("via_point-N", f"{tmp_path}/b/opt.py:Winner", [3.0, 4.0]),
    ]
    (found,) = table('task = "via_point"\noptimizer = "a/opt.py:Winner"\nseeds = 2')
    assert (found.label, found.random) == ("Winner", True)


def test_so_are_problems_and_explorations(table, tmp_path):
    assert shown(table('task = ["a/p.json", "b/p.json"]')) == [
        (f"{tmp_path}/a/p.json", "pibb", [1.0]),
        (f"{tmp_path}/b/p.json", "pibb", [2.0]),
    ]
    found = table('task = "two_starts"\nexploration = ["a/noise.py:Winner", "b/noise.py:Winner"]')
    assert [row.label for row in found] == [f"pibb, {tmp_path}/{folder}/noise.py:Winner" for folder in "ab"]


def test_so_are_other_values_that_end_alike(table, tmp_path):
    found = table('task = "via_point"\ndemonstrations = ["a/x.json", "b/x.json"]\nscale = [1.0, 2.0]')
    assert len({row.label for row in found}) == 4
    assert found[0].label == f"pibb scale=1.0 demonstrations={tmp_path}/a/x.json"


@pytest.mark.parametrize(
    ("optimizer", "cost", "random"),
    [
        ("adam", lambda n: 3.0, False),
        ("adam", lambda n: np.nan, False),
        ("adam", float, True),
        ("cma", lambda n: 3.0, True),
    ],
)
def test_runs_are_random_where_the_method_is_or_their_costs_differ(table, optimizer, cost, random):
    (found,) = table(f'task = "via_point"\noptimizer = "{optimizer}"\nseeds = 3', cost)
    assert found.random == random
