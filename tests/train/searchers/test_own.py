"""An optimizer, an exploration and a task in three dimensions that stand in a file of somebody else."""

import json

from train.learning.run import run
from train.options import options_for

FILE = """
import torch
from tasks import Task
from torchds import Demonstrations, costs
from torchds.exploration import Homogeneous
from torchds.optim import PIBB

class Half(PIBB):
    pass

class Quiet(Homogeneous):
    pass

class Space(Task):
    def default_demonstrations(self):
        s = torch.linspace(0, 1, 40, dtype=torch.float64)[:, None]
        return Demonstrations([torch.cat([s - 1, h * torch.sin(3 * s), 1 - s], 1) for h in (0.9, 1.0)], dt=0.1)

    def cost_terms(self, path):
        return {"goal": costs.goal(path.x, torch.ones(3, dtype=path.x.dtype))}
"""


def test_they_learn_and_their_places_are_kept(tmp_path, capsys):
    file = tmp_path / "of_somebody.py"
    file.write_text(FILE)
    own = {"optimizer": f"{file}:Half", "exploration": f"{file}:Quiet", "noise": 0.02}
    folder = run(options_for(f"{file}:Space", updates=2, rollouts=4, logdir=tmp_path / "logs", **own))
    assert folder.relative_to(tmp_path / "logs").parts[:2] == ("space", "Half")
    kept = json.loads((folder / "results.json").read_text())
    assert (kept["task"], kept["options"]["optimizer"]) == (f"{file}:Space", f"{file}:Half")
    usual = {"optimizer": "pibb", "exploration": "homogeneous", "noise": 0.02}
    again = run(options_for(f"{file}:Space", updates=2, rollouts=4, logdir=tmp_path / "logs", **usual))
    assert json.loads((again / "results.json").read_text())["cost"] == kept["cost"]
    assert "the positions of space have 3 dimensions" in capsys.readouterr().out
    assert [p.name for p in folder.glob("*.png")] == ["learning_curves.png"]
