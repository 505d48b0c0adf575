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
    faults = [
        ROOT / "tests" / "faults" / f"{name}.py" for name in ("killer", "scenarios", "test_runs", "test_sessions")
    ]
    tests = [*(ROOT / "tests" / "train").rglob("*.py"), *faults]  # what kills and questions commands belongs to them
    code = (ROOT / "train").rglob("*.py")
    assert lines(tests) >= 0.5 * lines(code)


def lines(paths):
    """All lines of some files."""
    return sum(len(path.read_text().splitlines()) for path in paths)
