"""Imports point one way: from rung to rung in each package, from train to tasks to torchds, and nowhere in a circle."""

import ast
import functools
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# A module may import modules of its own rung and below.
LIBRARY = [
    {"errors", "devices"},
    {"archives"},
    {"control"},
    {"kernels", "visits", "sharing", "arrays", "quartiles", "em", "files", "findings", "locks"},
    {"preparation", "mending", "policy_file"},
    {"mixture", "demonstrations", "costs", "stops", "forces", "disturbances", "stability", "metrics"},
    {"recordings", "poses", "parameters", "trainable", "starts", "kinematics", "arm_law"},
    {"policy", "targets"},
    {"fused_arm", "plants", "passive", "cartesian", "saving", "c_header"},
    {"arms"},
    {"moments", "scanning", "impedance", "rollouts", "dmp"},
    {"sensitivity", "exporting", "fits", "recruiting"},
    {"exploration"},
    {"optim", "plotting"},
    {"sessions", "monitor"},
    {"testing"},
]
TASKS = [
    {"settings", "loading", "plain", "imitation"},
    {"base"},
    {"via_point", "two_starts", "constrained_reaching", "force_fields", "lwr_digging", "transfer", "trials", "sketch"},
    {"released", "digging"},
    {"registry"},
    {"gym"},
]
COMMANDS = [
    {"options", "tables", "statistics"},
    {"folder"},
    {"searchers"},
    {"learning"},
    {"paper", "compare", "beyond", "lasa", "deep_rl", "hardware", "benchmark", "view"},
    {"__main__"},
]


def files(package):
    """The path of every module by its dotted name; a package has the name of its folder."""
    paths = sorted((ROOT / package).rglob("*.py"))
    return {".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in paths}


MODULES = files("torchds") | files("tasks") | files("train")


@functools.cache
def imported(path, types=True):
    """The modules of this project that a file imports; with `types`, those that only its annotations need too."""
    tree = ast.parse(path.read_text())
    guarded = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for child in ast.walk(node)
    }
    names = set()
    for node in ast.walk(tree):
        if id(node) in guarded and not types:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path} has a relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    # `from package import name` means a module of the package, or what its __init__ defines.
    whole = {name if name in MODULES else name.rpartition(".")[0] for name in names}
    return whole & set(MODULES)


@pytest.mark.parametrize("package, ladder", [("torchds", LIBRARY), ("tasks", TASKS), ("train", COMMANDS)])
def test_imports_go_down_the_ladder(package, ladder):
    rung = {name: i for i, names in enumerate(ladder) for name in names}
    for module, path in files(package).items():
        for name in imported(path, types=False):
            if "." in module and name.startswith(f"{package}."):
                assert rung[name.split(".")[1]] <= rung[module.split(".")[1]], f"{module} imports {name}"


@pytest.mark.parametrize("package, others", [("torchds", {"tasks", "train"}), ("tasks", {"train"})])
def test_the_rooms_are_entered_in_one_order(package, others):
    for module, path in files(package).items():
        assert not others & {name.split(".")[0] for name in imported(path)}, module


def test_optimizers_know_no_policy_no_rollout_and_no_task():
    for path in (ROOT / "torchds" / "optim").glob("*.py"):
        assert not {"torchds.policy", "torchds.rollouts", "torchds.mixture"} & imported(path, types=False), path


def test_no_imports_in_a_circle_not_even_of_types():
    graph = {module: imported(path) - {module} for module, path in MODULES.items()}
    TopologicalSorter(graph).prepare()
