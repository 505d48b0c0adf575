"""Tests mirror the folders: whoever looks for the test of a module finds it at the same place."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("package", ["torchds", "tasks"])
def test_every_module_has_its_test(package):
    modules = [path.relative_to(ROOT) for path in (ROOT / package).rglob("*.py") if path.name != "__init__.py"]
    tests = [Path("tests", module.parent, f"test_{module.name}") for module in modules]
    assert not [str(test) for test in tests if not (ROOT / test).is_file()]


def test_commands_are_tested_by_half_as_many_lines_as_they_have():
    code, tests = (
        sum(len(path.read_text().splitlines()) for path in folder.rglob("*.py"))
        for folder in (ROOT / "train", ROOT / "tests" / "train")
    )
    assert tests >= 0.5 * code
