"""Tests mirror the folders: whoever looks for the test of a module finds it at the same place."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("package", ["torchds", "tasks"])
def test_every_module_has_its_test(package):
    """At the same path under tests/; the modules of a small package may share the test of the package."""
    missing = []
    for module in sorted((ROOT / package).rglob("*.py")):
        place = module.relative_to(ROOT)
        tests = [place.with_name(f"test_{place.name}"), place.parent.with_name(f"test_{place.parent.name}.py")]
        if not module.name.startswith("__") and not any((ROOT / "tests" / test).is_file() for test in tests):
            missing.append(str(place))
    assert not missing
