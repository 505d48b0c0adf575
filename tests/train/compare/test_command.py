"""python -m train compare: fair, complete, resumable, and what it writes is what was measured."""

import csv
import json
import time
from dataclasses import replace

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.motions import Short
from tests.tasks.sketch.drawn import FULL
from torchds.errors import InvalidArgumentError, UnknownNameError
from train.compare import command as compare
from train.compare.command import Candidate, Compare, added, named
from train.folder import Interrupted
from train.learning import kept
from train.learning.learner import Learner
from train.options import options_for

SMALL = {
    "tasks": ("via_point-N",),
    "optimizers": ("pibb", "cobyqa", "adam"),
    "runs": 3,
    "tuning_runs": 2,
    "updates": 2,
    "factors": (0.1, 1.0),
}


@pytest.fixture(autouse=True, scope="module")
def task():
    """All problems are one short letter."""
    task = Short()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compare, "made", lambda options: task)
        yield task


@pytest.fixture(scope="module")
def finished(task, tmp_path_factory):
    return Compare(**SMALL, logdir=tmp_path_factory.mktemp("logs")).main()


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_every_row_is_there_with_what_a_run_of_its_own_gives(finished, task):
    rows = {row["optimizer"]: row for row in read(finished / "table.csv")}
    assert list(rows) == [f"{o}{c}" for o in SMALL["optimizers"] for c in ("", ", trajectory")]
    factor = {"0.1": 0.1, "1": 1.0}[rows["pibb"]["factor"]]
    cost = Learner(options_for("via_point", runs=3, updates=2, scale=factor), task).learn().history.cost
    quartiles = [f"{q:.3g}" for q in np.quantile(cost[-1], [0.25, 0.5, 0.75])]
    assert [rows["pibb"][name] for name in ("q1", "final median", "q3")] == quartiles
    assert {row["initial"] for row in rows.values()} == {f"{cost[0][0]:.3g}"}
    assert {row["roll-outs"] for row in rows.values()} == {"20"}
    assert [row["gradients"] for row in rows.values()] == ["no"] * 4 + ["yes"] * 2
    assert rows["pibb"]["runs"] == "3"
    assert rows["adam"]["runs"] == "1, deterministic"
    assert rows["adam"]["forward-equivalents"] == "80"


def test_the_factor_is_the_best_of_the_tuning_runs_which_have_seeds_of_their_own(finished):
    runs = finished.parent / "runs" / "via_point"
    found = [json.loads((folder / "results.json").read_text()) for folder in runs.glob("pibb-*")]
    plain = [record for record in found if record["options"]["exploration"] == "homogeneous"]
    tuning = {r["options"]["scale"]: np.median(r["cost"][-1]) for r in plain if r["options"]["seed"] == 1000}
    (reported,) = (r for r in plain if r["options"]["seed"] == 0)
    assert set(tuning) == {0.1, 1.0}
    assert reported["options"]["scale"] == min(tuning, key=tuning.get)
    text = (finished / "report.md").read_text()
    assert f"| via_point-N | pibb | {tuning[0.1]:.3g} | {tuning[1.0]:.3g} |" in text


def test_curves_figure_and_tensorboard_are_written(finished):
    curves = read(finished / "curves.csv")
    assert [row["roll-outs"] for row in curves if row["optimizer"] == "pibb"] == ["0", "10", "20"]
    assert (finished / "curves.png").stat().st_size > 10_000
    events = EventAccumulator(str(finished / "000")).Reload()
    assert "hparam/final_cost_median" in events.Tags()["scalars"]


@pytest.mark.slow
def test_runs_that_exist_are_not_made_again(finished, monkeypatch):
    def update(learner):
        raise AssertionError("this run exists")

    monkeypatch.setattr(Learner, "update", update)
    again = Compare(**SMALL, logdir=finished.parents[1])
    monkeypatch.setattr(time, "strftime", lambda form: "again")
    assert read(again.main() / "table.csv") == read(finished / "table.csv")


@pytest.mark.slow
def test_an_interrupted_comparison_continues_and_ends_the_same(finished, tmp_path, monkeypatch):
    left, update = [5], Learner.update

    def interrupted(learner):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return update(learner)

    monkeypatch.setattr(kept, "SAVE_EVERY", -1.0)
    monkeypatch.setattr(Learner, "update", interrupted)
    with pytest.raises(Interrupted, match="the same command continues"):
        Compare(**SMALL, logdir=tmp_path).main()
    left[0] = 10**6
    folder = Compare(**SMALL, logdir=tmp_path).main()
    # In 6 rows: two factors, and once more the best on other seeds where these matter.
    assert 10**6 - left[0] == 2 * (2 * 3 + 4 * 2) - 5
    timed = {"seconds"}
    for a, b in zip(read(folder / "table.csv"), read(finished / "table.csv"), strict=True):
        assert {k: v for k, v in a.items() if k not in timed} == {k: v for k, v in b.items() if k not in timed}


@pytest.mark.slow
def test_what_a_task_refuses_is_said_and_not_a_failure(task, tmp_path, monkeypatch):
    monkeypatch.setattr(task, "differentiable", False, raising=False)
    folder = Compare(
        **{**SMALL, "optimizers": ("pibb", "adam"), "coordinates": ("plain",), "factors": (1.0,)}, logdir=tmp_path
    ).main()
    refused = {row["optimizer"]: row["refused"] for row in read(folder / "table.csv")}
    assert refused["pibb"] == ""
    assert "needs the gradient of a trial" in refused["adam"]
    assert "Cannot be had:\n\n- adam: " in (folder / "report.md").read_text()


@pytest.mark.slow
def test_other_runs_can_be_added(finished, tmp_path):
    others = (finished.parent / "runs" / "via_point").glob("cobyqa-*")
    said = {each: json.loads((each / "options.json").read_text())["options"] for each in others}
    (other,) = (each for each in said if (said[each]["scale"], said[each]["exploration"]) == (0.1, "trajectory"))
    small = {**SMALL, "optimizers": ("pibb",), "coordinates": ("plain",), "factors": (1.0,), "updates": 1}
    folder = Compare(**small, add=(other,), logdir=tmp_path).main()
    assert [row["optimizer"] for row in read(folder / "table.csv")] == [
        "pibb",
        "cobyqa exploration=trajectory scale=0.1, added",
    ]
    with pytest.raises(InvalidArgumentError, match=r"--add nowhere: no results\.json there"):
        Compare(**small, add=(tmp_path.__class__("nowhere"),), logdir=tmp_path).main()


@pytest.mark.slow
def test_noise_makes_deterministic_methods_random(tmp_path):
    small = {**SMALL, "optimizers": ("cobyqa",), "coordinates": ("plain",), "factors": (1.0,), "updates": 6}
    folder = Compare(**small, noise_std=0.3, logdir=tmp_path).main()
    (row,) = read(folder / "table.csv")
    assert row["runs"] == "3"
    assert row["q1"] != row["q3"]
    assert "normal noise of 0.3 times the initial cost" in (folder / "report.md").read_text()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"tasks": ("via_point",)}, UnknownNameError, "unknown problem 'via_point'.*via_point-N"),
        ({"optimizers": ("adm",)}, UnknownNameError, "unknown optimizer 'adm'. Did you mean 'adam'"),
        ({"factors": (0.0,)}, InvalidArgumentError, "positive --factors"),
        ({"factors": (1.0, float("nan"))}, InvalidArgumentError, "positive --factors"),
        ({"updates": -3}, InvalidArgumentError, "--updates"),
        ({"runs": 0}, InvalidArgumentError, "--runs"),
        ({"noise_std": -1.0}, InvalidArgumentError, "--noise-std"),
    ],
)
def test_wrong_options_are_refused_before_anything_runs(options, error, words, tmp_path):
    with pytest.raises(error, match=words):
        Compare(**options, logdir=tmp_path).main()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("usual", "plain", "trajectory"),
    [
        ("trajectory", "homogeneous", "trajectory"),
        ("gaussian", "homogeneous", "trajectory"),
        ("stable", "stable", "stable-trajectory"),
        ("stable-trajectory", "stable", "stable-trajectory"),
    ],
)
def test_coordinates_are_what_they_are_called_whatever_a_task_takes_by_itself(usual, plain, trajectory, tmp_path):
    file = str(tmp_path / "mine.json")
    replace(FULL, learners=({"exploration": usual, "updates": 7, "rollouts": 3},)).write(file)

    def options(coordinates, **given):
        return Compare(tasks=(file,), **given).options(Candidate(file, "cma", coordinates), 1.0, 2, 0)

    assert [options(kind).exploration for kind in ("plain", "trajectory")] == [plain, trajectory]
    assert (options("plain").updates, options("plain").rollouts) == (7, 3)
    assert options("plain", updates=2).updates == 2
    assert options("plain").shrink == ("none" if plain == "stable" else "all")


@pytest.mark.parametrize(
    ("costs", "choice"),
    [([1.0, 2.0, np.nan], 2.0), ([3.0, np.nan, np.inf], np.inf), ([1.0, 2.0, 3.0], 2.0), ([1.0, -np.inf, 2.0], 2.0)],
)
def test_a_factor_is_judged_by_the_median_that_the_report_shows(costs, choice, monkeypatch):
    monkeypatch.setattr(Compare, "learned", lambda *_: {"cost": [costs]})
    monkeypatch.setattr(Compare, "random", lambda *_: True)
    assert Compare().final(Candidate("via_point-N", "pibb", "plain"), 1.0, None) == choice


@pytest.mark.parametrize(
    ("task", "options", "problem", "label"),
    [
        ("via_point", {"shape": "P", "scale": 3, "updates": 7}, "via_point-P", "pibb scale=3, added"),
        ("via_point", {"shape": "N", "convention": "released"}, "via_point-N convention=released", "pibb, added"),
        (
            "divergent_field",
            {"execution": "closed", "pushes": 0.5, "decay": "none", "rollouts": 20},
            "divergent_field execution=closed pushes=0.5",
            "pibb decay=none rollouts=20, added",
        ),
        ("via_point", {"shape": "N", "optimizer": "ppo", "environment": "ViaPointN"}, "via_point-N", "ppo, added"),
    ],
)
def test_what_is_added_says_what_is_not_as_usual(task, options, problem, label):
    record = {"task": task, "options": {"optimizer": "pibb", **options}}
    row = added(record, named((), [record]))
    assert (row.problem, row.label) == (problem, label)


def test_places_of_one_short_name_have_rows_and_problems_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, other = (Candidate(f"{folder}/p.json", f"{folder}/opt.py:Winner", "plain") for folder in "ab")
    record = {"task": f"{tmp_path}/c/p.json", "options": {"optimizer": "ppo"}}
    names = named([one, other._replace(coordinates="c.d:Noise")], [record])
    assert [names[each.problem] for each in (one, other)] == [f"{tmp_path}/a/p.json", f"{tmp_path}/b/p.json"]
    assert one.label(names) == f"{tmp_path}/a/opt.py:Winner"
    assert other._replace(coordinates="c.d:Noise").label(names) == f"{tmp_path}/b/opt.py:Winner, Noise"
    assert (added(record, names).problem, added(record, names).label) == (f"{tmp_path}/c/p.json", "ppo, added")
    assert one.label(named([one])) == "Winner" and named([one])[one.problem] == "p"
