"""Shared by the tests of the paper's claims: a digging experiment that never was."""

import json

import numpy as np
import pytest

from train.folder import RunFolder
from train.learning.history import History, results
from train.paper.measured.digging import UNIFORM, Experiment


@pytest.fixture
def dug(tmp_path):
    """An experiment that never was: whose best uniform stiffness is 250, and whose learner does what the paper says."""
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

    measured = {
        f"uniform-{s:g}": trials(2 + abs(s - 250) / 100, load=s / 100, force=s / 200, stiffness=s) for s in UNIFORM
    }
    measured["as in the paper-150"] = trials(1.0, load=4.0, force=0.8, stiffness=220)
    measured["as in the paper-400"] = trials(1.5, load=4.0, force=0.9, stiffness=270)
    experiment = Experiment(tmp_path / "lwr_digging" / "experiment-0", 0)
    experiment.folder.mkdir(parents=True)
    (experiment.folder / "trials.json").write_text(json.dumps({"trials": measured}))
    folder = experiment.run_folder("as in the paper", 400).path
    folder.mkdir()
    gravel = [[g] for g in (-2.0, -1.5, -1.2, -1.4, -1.9, -2.1)]
    history = History([0] * 6, gravel, {"gravel": gravel}, [0] * 6, [0] * 6)
    RunFolder(folder).write_results(results("lwr_digging", {}, history))
    return experiment
