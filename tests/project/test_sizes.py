"""Files stay small, a folder can be seen at a glance, and each module of the library has a test that mirrors its place."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def lines(path):
    return len(path.read_text().splitlines())


@pytest.mark.parametrize("package, most", [("torchds", 350), ("tasks", 350), ("train", 300)])
def test_no_file_is_long(package, most):
    long = {str(p.relative_to(ROOT)): lines(p) for p in (ROOT / package).rglob("*.py") if lines(p) > most}
    assert not long


def test_the_commands_can_be_seen_at_a_glance():
    entries = {p.name for p in (ROOT / "train").iterdir()} - {"__pycache__"}
    assert len(entries) <= 16, entries
