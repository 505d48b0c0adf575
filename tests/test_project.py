"""What holds for the project as a whole: packaging, imports, examples."""

import ast
import doctest
import importlib
import os
import pkgutil
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
import torch

import torchds

ROOT = Path(__file__).parents[1]

# A module may import modules of its own rung and below.
LADDER = [
    {"errors"},
    {"visits"},
    {"mixture", "demonstrations", "recordings", "costs", "stability", "metrics"},
    {"parameters", "trainable"},
    {"policy"},
    {"plants", "cartesian"},
    {"impedance", "rollouts"},
    {"sensitivity", "fits", "recruiting"},
    {"exploration"},
    {"optim", "plotting"},
]


def modules(package):
    return [info.name for info in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]


def imported(path):
    """The names of modules that a file imports, type checking apart."""
    tree = ast.parse(path.read_text())
    guarded = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for child in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in guarded:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_dependencies_point_one_way():
    rung = {name: i for i, names in enumerate(LADDER) for name in names}
    for path in (ROOT / "torchds").rglob("*.py"):
        own = path.relative_to(ROOT / "torchds").parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        for name in imported(path):
            assert not name.startswith(("tasks", "train")), f"{path} imports {name}"
            if name.startswith("torchds."):
                other = name.split(".")[1]
                assert rung[other] <= rung[own], f"torchds.{own} imports torchds.{other}"


def test_optimizers_know_no_policy_no_rollout_and_no_task():
    for path in (ROOT / "torchds" / "optim").glob("*.py"):
        assert not {"policy", "rollouts", "mixture"} & {
            n.split(".")[1] for n in imported(path) if n.startswith("torchds.")
        }


def test_tasks_do_not_import_train():
    for path in (ROOT / "tasks").rglob("*.py"):
        assert not [name for name in imported(path) if name.startswith("train")]


def test_every_public_name_exists():
    for package in (torchds, torchds.exploration, torchds.optim, importlib.import_module("tasks")):
        for name in package.__all__:
            assert getattr(package, name) is not None


@pytest.mark.parametrize("name", ["torchds", *modules(torchds)])
def test_the_examples_in_docstrings_run(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_the_example_of_the_readme_runs_and_learns():
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    space = {}
    exec(example, space)
    with torch.no_grad():
        assert float(space["closure"]()) < 1.0  # 3.1 before learning


def test_importing_torchds_needs_neither_the_extras_nor_the_checkout(tmp_path):
    """Build the wheel and import it in a clean environment that sees only torch, numpy, scipy and scikit-learn."""
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} <= {
        "torchds",
        *(n.split("/")[0] for n in names if ".dist-info/" in n),
    }
    venv.create(tmp_path / "venv", with_pip=False)
    target = next((tmp_path / "venv").rglob("site-packages"))
    zipfile.ZipFile(wheel).extractall(target)
    # Third-party packages come from this environment; its .pth files, which lead to the checkout, are not read there.
    (target / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    code = (
        "import sys, torchds; assert torchds.__file__.startswith(sys.argv[1]), torchds.__file__;"
        "extras = {'matplotlib', 'tensorboard', 'tyro', 'dtaidistance', 'mujoco', 'pytorch_kinematics', 'tasks', 'train'};"
        "assert not extras & set(sys.modules), extras & set(sys.modules)"
    )
    python = tmp_path / "venv" / "bin" / "python"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    subprocess.run([python, "-c", code, str(target)], check=True, cwd=tmp_path, env=environment)


def test_the_versions_agree():
    assert re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)[1] == torchds.__version__
