"""What `import torchds` costs, and which modules are promised to stay."""

import importlib
import inspect
import pkgutil
import re
import resource
import subprocess
import sys
from pathlib import Path
from statistics import median

import pytest

import torchds

ROOT = Path(__file__).parents[2]
MODULES = ["torchds", *(info.name for info in pkgutil.walk_packages(torchds.__path__, "torchds."))]


def run(code):
    return subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True).stdout


@pytest.mark.slow
def test_importing_the_library_imports_nothing_heavy():
    loaded = run("import sys, torchds; print(*{name.split('.')[0] for name in sys.modules})").split()
    assert "torch" in loaded and "numpy" in loaded
    heavy = {"sklearn", "scipy", "matplotlib", "pandas", "numba", "triton", "mujoco", "tensorboard", "dtaidistance"}
    assert not heavy & set(loaded)


def cpu_seconds(code):
    """Processor time of a process that runs the code; unlike the time of the clock, it is the same on a busy machine."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run(code)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


@pytest.mark.slow
def test_importing_the_library_takes_hardly_longer_than_importing_torch():
    seconds = {"torch": [], "torchds": []}
    for _ in range(3):  # in turn, so that both meet the same caches
        for name, taken in seconds.items():
            taken.append(cpu_seconds(f"import {name}"))
    assert median(seconds["torchds"]) <= 1.3 * median(seconds["torch"])


def stability(name):
    return re.findall(r"^Stability: (.*)$", importlib.import_module(name).__doc__, re.M)


@pytest.mark.parametrize("name", MODULES)
def test_every_module_says_whether_it_will_stay(name):
    assert stability(name) in (["stable."], ["experimental."])


@pytest.mark.parametrize("package", [torchds, torchds.exploration, torchds.optim, torchds.recordings])
def test_what_a_package_offers_is_stable(package):
    offered = [getattr(package, name) for name in package.__all__]
    modules = {item.__name__ if inspect.ismodule(item) else item.__module__ for item in offered}
    assert [name for name in modules if stability(name) != ["stable."]] == []


def test_what_the_pages_tell_to_use_is_stable():
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    named = {name for page in pages for name in re.findall(r"(?<![\w.])torchds(?:\.\w+)+", page.read_text())}
    modules = {module for module in MODULES if any(name == module or name.startswith(module + ".") for name in named)}
    assert {"torchds.visits", "torchds.parameters", "torchds.testing"} <= modules
    assert [name for name in modules if stability(name) != ["stable."]] == []
