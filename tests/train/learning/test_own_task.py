"""A task that stands outside the repository, with real processes: learned, killed, resumed, compared, drawn."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

CIRCLE = '''
"""A task of a stranger."""
import torch
import tasks
from torchds import Demonstrations, costs

class RoundTheHouse(tasks.Task):
    """Go round a house on the far side.

    More about the house.
    """

    height: float = 150.0
    """How far the house reaches [cm]."""

    def default_demonstrations(self):
        s = torch.linspace(0, 1, 60, dtype=torch.float64)[:, None]
        ways = [torch.cat([-400 * (1 - s), 100 * h * torch.sin(torch.pi * s)], 1) for h in (0.9, 1.0, 1.1)]
        return Demonstrations(ways, dt=0.05, units="cm")

    def cost_terms(self, path):
        house = torch.tensor([[-200.0, self.height]], dtype=path.x.dtype)
        return {"house": costs.via_points(path.x, house), "goal": costs.goal(path.x, torch.zeros(2, dtype=path.x.dtype))}
'''


@pytest.fixture
def train(tmp_path):
    """Runs `python -m train` in a folder elsewhere; `wait=False` returns the process."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}

    def run(*arguments, wait=True, code=0):
        command = [sys.executable, "-m", "train", *map(str, arguments)]
        pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, **pipe)
        if not wait:
            return process
        output, _ = process.communicate(timeout=200)
        assert process.returncode == code, output
        return output

    return run


@pytest.mark.slow
def test_a_task_from_elsewhere_is_learned_killed_resumed_compared_and_drawn(train, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    file = tmp_path / "elsewhere" / "my_file.py"
    file.write_text(CIRCLE)
    spec, given = (
        "elsewhere/my_file.py:RoundTheHouse",
        ("--height", "160", "--runs", "2", "--rollouts", "5", "--seed", "3"),
    )
    whole = train(spec, *given, "--updates", "30", "--logdir", "whole")
    assert "house" in whole and "control" in whole

    process = train(spec, *given, "--updates", "30", "--logdir", "killed", wait=False)
    began = time.monotonic()
    while not (found := list((tmp_path / "killed").rglob("checkpoint.pt"))):
        assert process.poll() is None and time.monotonic() - began < 120
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.stdout.close()
    folder = found[0].parent
    assert not (folder / "results.json").exists()
    assert folder.relative_to(tmp_path).parts[:3] == ("killed", "round_the_house", "pibb")
    kept = json.loads((folder / "options.json").read_text())
    assert kept["task"] == f"{file}:RoundTheHouse"
    assert kept["options"]["height"] == 160.0

    train(kept["task"], "--resume", folder)
    (straight,) = (tmp_path / "whole").rglob("results.json")
    resumed, straight = (json.loads(p.read_text()) for p in (folder / "results.json", straight))
    assert resumed["cost"] == straight["cost"]
    assert resumed["task"] == f"{file}:RoundTheHouse"
    first, last = resumed["cost"][0], resumed["cost"][-1]
    assert max(last) < 0.7 * min(first)
    assert {p.name for p in folder.glob("*.png")} == {"motion.png", "learning_curves.png"}

    text = train(
        *("compare", "--tasks", spec, "--optimizers", "adam", "surrogate", "--coordinates", "trajectory"),
        *("--runs", "2", "--updates", "3", "--factors", "1", "--logdir", "compared"),
    )
    assert "adam" in text and "surrogate" in text and "refused" not in text
    assert len(list((tmp_path / "compared" / "compare" / "runs" / "round_the_house").iterdir())) == 2

    file.rename(file.with_name("moved.py"))
    assert f"no file {file}" in train("via_point", "--resume", folder, code=2)


@pytest.mark.slow
def test_its_options_are_explained_and_mistakes_are_named(train, tmp_path):
    (tmp_path / "my_file.py").write_text(CIRCLE)
    text = " ".join(train("my_file.py:RoundTheHouse", "--help").replace("│", " ").split())
    assert "Go round a house on the far side." in text
    assert "--height FLOAT How far the house reaches [cm]. (default: 150.0)" in text
    assert "Did you mean 'RoundTheHouse'?" in train("my_file.py:RoundTheHose", code=2)
