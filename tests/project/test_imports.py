"""What `import torchds` costs, and which modules are promised to stay."""

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import torchds

ROOT = Path(__file__).parents[2]
MODULES = ["torchds", *(info.name for info in pkgutil.walk_packages(torchds.__path__, "torchds."))]


IMPORT = """
import sys, time
begin = time.process_time()  # unlike the time of the clock, it is the same on a busy machine
import torch
torch_alone = time.process_time() - begin
import torchds
print(torch_alone, time.process_time() - begin, *{name.split(".")[0] for name in sys.modules})
"""


@pytest.fixture(scope="module")
def imports():
    """Of two new processes: seconds of `import torch`, of that and `import torchds`, and the packages that are loaded then."""
    command = [sys.executable, "-c", IMPORT]
    outputs = [subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True).stdout for _ in range(2)]
    return [(float(alone), float(both), set(loaded)) for alone, both, *loaded in map(str.split, outputs)]


@pytest.mark.slow
def test_importing_the_library_imports_nothing_heavy(imports):
    loaded = imports[0][2]
    assert {"torch", "numpy"} <= loaded
    heavy = {"sklearn", "scipy", "matplotlib", "pandas", "numba", "triton", "mujoco", "tensorboard", "dtaidistance"}
    assert not heavy & loaded


@pytest.mark.slow
def test_importing_the_library_takes_hardly_longer_than_importing_torch(imports):
    assert min(both / alone for alone, both, _ in imports) <= 1.3


def stability(name):
    try:
        module = importlib.import_module(name)
    except torchds.errors.MissingPackageError as error:
        pytest.skip(str(error))
    return re.findall(r"^Stability: (.*)$", module.__doc__, re.M)


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
