"""What docs/monitoring.md shows runs as it stands there, in a new process and an empty folder."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "monitoring.md").read_text(), re.DOTALL)
SEARCH, *LOOPS = [block for block in BLOCKS if not re.search("wandb|mlflow|optuna", block)]
RECIPES = {name: next(block for block in BLOCKS if name in block) for name in ("wandb", "mlflow", "optuna")}
LEFT = {
    "wandb": "assert list(__import__('pathlib').Path('wandb').glob('offline-run-*'))",
    "mlflow": "assert len(list(__import__('pathlib').Path('mlruns').glob('0/*/metrics/cost/total'))) == 1",
    "optuna": "assert len(study.trials) == 5 and min(study.best_trial.intermediate_values) == 10",
}


def run(code, folder):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "WANDB_SILENT": "true"}
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_loops_run_as_they_stand(tmp_path):
    loops = LOOPS if find_spec("pandas") else [block for block in LOOPS if "to_dataframe" not in block]
    said = run(SEARCH + "\n".join(loops) + "\nprint([step for step, cost in seen])", tmp_path)
    assert said.endswith("[10, 20, 30, 40, 50]\n") and list((tmp_path / "logs" / "mine").glob("events*"))


@pytest.mark.slow
@pytest.mark.parametrize("package", RECIPES)
def test_a_recipe_of_a_tracker_runs_as_it_stands(package, tmp_path):
    pytest.importorskip(package)
    run(SEARCH + RECIPES[package] + LEFT[package], tmp_path)
