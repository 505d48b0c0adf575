"""Every public name exists, has examples that run, and the version is one."""

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import torchds
from torchds.errors import MissingPackageError

ROOT = Path(__file__).parents[2]


def modules(package):
    return [info.name for info in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]


@pytest.mark.parametrize("name", ["torchds", "torchds.exploration", "torchds.optim", "tasks"])
def test_every_public_name_exists(name):
    package = importlib.import_module(name)
    for public in package.__all__:
        assert getattr(package, public) is not None


@pytest.mark.parametrize("name", ["torchds", *modules(torchds)])
@pytest.mark.slow
def test_the_examples_in_docstrings_run(name):
    try:
        module = importlib.import_module(name)
    except MissingPackageError as missing:  # compiled code, without what compiles it
        pytest.skip(str(missing))
    assert doctest.testmod(module).failed == 0


def test_the_versions_agree():
    assert re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)[1] == torchds.__version__
