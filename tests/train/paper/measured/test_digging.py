"""The digging experiment's books: where things stand, and what is taken from them."""

import pytest

from train.paper.measured import digging


def test_each_run_has_a_folder_of_its_own(tmp_path):
    experiment = digging.Experiment(tmp_path, 3)
    folders = {experiment.run_folder(search, start).path for search in digging.SEARCHES for start in digging.STARTS}
    assert {folder.name for folder in folders} == {"pibb-150", "pibb-400", "surrogate-150", "surrogate-400"}
    assert all(folder.parent == tmp_path for folder in folders)
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_there_is_none(tmp_path):
    experiment = digging.Experiment(tmp_path, 0)
    assert experiment.recorded() == {}
    assert digging.uniform_trials(experiment, 150) is None
    assert digging.learned_trials(experiment, 150) is None
    assert digging.curves(experiment, 150) is None


def test_trials_and_curves_are_read_as_they_were_written(dug):
    assert digging.uniform_trials(dug, 200)["gravel/load"][2] == pytest.approx(2.0)
    assert digging.learned_trials(dug, 150)["total"][2] == pytest.approx(1.0)
    assert digging.curves(dug, 400)["gravel"].tolist() == [-2.0, -1.5, -1.2, -1.4, -1.9, -2.1]
    assert digging.curves(dug, 150) is None


def test_the_best_uniform_stiffness_has_the_lowest_mean_and_learned_policies_do_not_count():
    trials = {
        "uniform-100": {"total": [1.0, 3.0]},
        "uniform-200": {"total": [0.0, 3.5]},
        "as in the paper-150": {"total": [0.0]},
    }
    assert digging.best_uniform(trials) == "uniform-200"
