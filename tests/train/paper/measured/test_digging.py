"""The digging experiment's books: where things stand, in which order they are made, and what is taken from them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from torchds.errors import FileError
from train.folder import RunFolder
from train.learning.history import results
from train.options import options_for
from train.paper.measured import digging


def test_each_run_has_a_folder_of_its_own(tmp_path):
    experiment = digging.Experiment(tmp_path, 3)
    folders = {
        experiment.run_folder(search, start, run).path
        for search in digging.SEARCHES
        for start in digging.STARTS
        for run in range(2)
    }
    assert {folder.name for folder in folders} == {
        f"{optimizer}-{start}-{run}" for optimizer in ("pibb", "surrogate") for start in (150, 400) for run in (0, 1)
    }
    assert all(folder.parent == tmp_path for folder in folders)
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_there_is_empty(tmp_path):
    experiment = digging.Experiment(tmp_path, 0)
    assert experiment.recorded() == {}
    assert digging.trials({}, "uniform-150") == digging.means({}, "recommended-150") == {}
    assert digging.history(experiment, digging.PAPER, 150) is None


def test_a_round_of_everything_comes_before_the_next(dug):
    more = digging.Experiment(dug.folder, 0, runs=7)
    cells = len(digging.UNIFORM) + 4
    assert dug.missing() == []
    assert len(more.missing()) == 2 * cells
    assert {name.rpartition("-")[2] for name in more.missing()[:cells]} == {"5"}


def test_trials_means_and_curves_are_read_as_they_were_written(dug):
    recorded = dug.recorded()
    assert digging.trials(recorded, "uniform-200")["gravel/load"].shape == (25,)
    assert digging.trials(recorded, "uniform-200")["gravel/load"][2] == pytest.approx(2.0)
    np.testing.assert_allclose(digging.means(recorded, "as in the paper-150")["total"], 1.0 + 0.003 * np.arange(5))
    curves = digging.history(dug, digging.PAPER, 400)
    assert np.shape(curves.cost) == (6, 5)
    np.testing.assert_allclose(
        np.array(curves.terms["gravel"])[:, 1], np.array([-2.0, -1.5, -1.2, -1.4, -1.9, -2.1]) + 0.003
    )
    assert digging.history(dug, digging.PAPER, 150) is None


def test_the_best_uniform_stiffness_has_the_lowest_mean_and_learned_policies_do_not_count():
    trials = {
        "uniform-100-0": {"total": [1.0, 3.0]},
        "uniform-100-1": {"total": [1.0, 3.0]},
        "uniform-200-0": {"total": [0.0, 3.5]},
        "as in the paper-150-0": {"total": [0.0]},
    }
    assert digging.best_uniform(trials) == "uniform-200"


def test_a_trial_that_failed_costs_the_most():
    nan = float("nan")
    trials = {"uniform-100-0": {"total": [nan, 1.0], "force/peak": [nan, 2.0]}, "uniform-200-0": {"total": [5.0, 6.0]}}
    assert digging.best_uniform(trials) == "uniform-200"
    assert digging.trials(trials, "uniform-100")["total"].tolist() == [np.inf, 1.0]
    assert digging.means(trials, "uniform-100")["total"].tolist() == [np.inf]
    assert np.isnan(digging.means(trials, "uniform-100")["force/peak"]).all()  # nobody knows


def test_all_runs_that_are_there_are_shown_however_many_there_shall_be(dug):
    fewer = digging.Experiment(dug.folder, 0, runs=2)
    assert np.shape(digging.history(fewer, digging.PAPER, 400).cost) == (6, 5)
    (dug.folder / "pibb-400-notes").mkdir()
    assert np.shape(digging.history(fewer, digging.PAPER, 400).cost) == (6, 5)


def test_the_budget_is_that_of_the_runs_that_are_there(dug, tmp_path):
    assert digging.budget(dug) == 40
    assert digging.budget(digging.Experiment(tmp_path / "none", 0)) == 80
    other = digging.Experiment(tmp_path / "none", 0, options_for("lwr_digging", updates=3, rollouts=2))
    assert digging.budget(other) == 6


@pytest.mark.parametrize("updates", [None, 10])
def test_runs_of_the_tasks_own_number_of_updates_are_accepted_however_it_is_said(dug, updates):
    same = digging.Experiment(dug.folder, 0, options_for("lwr_digging", updates=updates))
    assert digging.history(same, digging.PAPER, 400) is not None


def test_runs_and_trials_of_another_number_of_updates_are_refused(dug):
    other = digging.Experiment(dug.folder, 0, options_for("lwr_digging", updates=20))
    words = r"made with 10 updates, and the experiment has 20; give --updates 10"
    with pytest.raises(FileError, match=rf"results\.json was {words}"):
        digging.history(other, digging.PAPER, 400)
    with pytest.raises(FileError, match=rf"results\.json was {words}"):
        other.learned(digging.PAPER, 400.0)
    trials = json.loads((dug.folder / "trials.json").read_text())
    said = {"task": "lwr_digging", "options": dug.options.to_json(), "versions": {}}
    digging.write_sealed(dug.folder / "trials.json", {**said, **trials})
    assert dug.recorded() == trials["trials"]
    with pytest.raises(FileError, match=rf"trials\.json was {words}"):
        other.recorded()


def test_a_run_that_was_begun_with_another_number_of_updates_is_not_gone_on_with(tmp_path):
    begun = digging.Experiment(tmp_path, 0, options_for("lwr_digging", updates=3))
    options = begun.run_options(digging.PAPER, 150.0)
    begun.run_folder(digging.PAPER, 150.0).begin(options.task, options.to_json())
    with pytest.raises(FileError, match=r"options\.json was made with 3 updates, and the experiment has 10"):
        digging.Experiment(tmp_path, 0).learned(digging.PAPER, 150.0)


def test_runs_of_different_lengths_are_not_shown_together(dug):
    curves = replace(digging.history(digging.Experiment(dug.folder, 0), digging.PAPER, 400), failed=[0] * 6)
    shorter = replace(curves, rollouts=curves.rollouts[:-1], forward_equivalents=[0] * 6)
    folder = dug.run_folder(digging.PAPER, 400, 2).path
    RunFolder(folder).write_results(results("lwr_digging", dug.run_options(digging.PAPER, 400, 2).to_json(), shorter))
    with pytest.raises(FileError, match=r"pibb-400-2 has 4 updates and \S+pibb-400-0 has 5; .* of one length"):
        digging.history(dug, digging.PAPER, 400)
