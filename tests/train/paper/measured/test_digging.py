"""The digging experiment's books: where things stand, in which order they are made, and what is taken from them."""

import numpy as np
import pytest

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
