"""The Makefile promises only what it can do."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAKEFILE = (ROOT / "Makefile").read_text()


def test_every_declared_target_has_a_rule():
    (declared,) = re.findall(r"^\.PHONY: (.*)$", MAKEFILE, re.M)
    rules = set(re.findall(r"^([a-z-]+):", MAKEFILE, re.M))
    assert rules == set(declared.split())


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", ".ci/run"])
def test_every_target_that_a_page_names_has_a_rule(page):
    rules = re.findall(r"^([a-z-]+):", MAKEFILE, re.M)
    if not (ROOT / page).exists():
        pytest.skip(f"no {page}")
    for target in re.findall(r"(?:^|`)make ([a-z-]+)(?![\w.])", (ROOT / page).read_text(), re.M):
        assert target in rules, f"{page} names make {target}"
