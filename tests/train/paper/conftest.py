"""Shared by the tests of the paper's claims: a digging experiment that never was."""

import json

import numpy as np
import pytest

from train.folder import RunFolder
from train.learning.history import History, results
from train.paper.measured.digging import SEARCHES, UNIFORM, Experiment


@pytest.fixture
def dug(tmp_path):
    """An experiment that never was: whose best uniform stiffness is 250, and whose learners do what the paper says."""
    jitter = np.array([-0.02, -0.01, 0.0, 0.01, 0.02])

    def trials(total, load, force, stiffness):
        means = {
            "total": total,
            "gravel/load": load,
            "force": force,
            "force/peak": 9 * force,
            "stiffness/mean": stiffness,
        }
        return {name: (mean + jitter).tolist() for name, mean in means.items()}

    measured = {}
    for run in range(5):
        shift = 0.003 * run
        for s in UNIFORM:
            measured[f"uniform-{s:g}-{run}"] = trials(
                2 + abs(s - 250) / 100 + shift, load=s / 100 + shift, force=s / 200 + shift, stiffness=s
            )
        for search in SEARCHES:
            measured[f"{search}-150-{run}"] = trials(
                1.0 + shift, load=4.0 + shift, force=0.8 + shift, stiffness=220 + run
            )
            measured[f"{search}-400-{run}"] = trials(
                1.5 + shift, load=4.0 + shift, force=0.9 + shift, stiffness=270 + run
            )
    experiment = Experiment(tmp_path / "lwr_digging" / "experiment-0", 0, runs=5)
    experiment.folder.mkdir(parents=True)
    (experiment.folder / "trials.json").write_text(json.dumps({"trials": measured}))
    for run in range(5):
        folder = experiment.run_folder("as in the paper", 400, run).path
        options = experiment.run_options("as in the paper", 400, run)
        folder.mkdir()
        gravel = [[g + 0.003 * run] for g in (-2.0, -1.5, -1.2, -1.4, -1.9, -2.1)]
        history = History([0, 8, 16, 24, 32, 40], gravel, {"gravel": gravel}, [0] * 6, [0] * 6)
        RunFolder(folder).write_results(results("lwr_digging", options.to_json(), history))
    return experiment
