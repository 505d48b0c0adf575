"""The pages for contributors name things that exist."""

import re
from pathlib import Path

import pytest
import yaml

import torchds

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_architecture_names_rooms_that_exist():
    page = (ROOT / "docs" / "architecture.md").read_text()
    rooms = re.findall(r"`((?:torchds|tasks|train|tests)/[\w/]*(?:\.py)?)`", page)
    assert len(rooms) > 30
    for room in rooms:
        path = ROOT / room
        assert path.is_dir() if room.endswith("/") else path.is_file(), room


@pytest.mark.parametrize("package", ["torchds", "tasks", "train"])
def test_the_architecture_names_every_module_or_its_folder(package):
    page = (ROOT / "docs" / "architecture.md").read_text()
    for path in (ROOT / package).rglob("*.py"):
        file = path.relative_to(ROOT)
        assert path.name == "__init__.py" or f"`{file}`" in page or f"`{file.parent}/`" in page, file


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_files_lead_somewhere(page):
    for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
        assert (page.parent / link).exists(), link


def test_the_citation_is_complete_and_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors", "version", "references"} <= set(citation)
    assert citation["version"] == torchds.__version__
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]][::4] == ["Rey", "Billard"]


def test_hooks_are_local_and_call_targets_of_the_makefile():
    (local,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    rules = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.M)
    assert local["repo"] == "local"
    for hook in local["hooks"]:
        assert hook["language"] == "system" and hook["entry"].removeprefix("make ") in rules
