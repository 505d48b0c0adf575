"""`make release-check` finds what a release lacks, and the changelog has what one needs."""

import re
import subprocess
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests import release

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
GOOD = "# Changelog\n\n## 1.2.0 (2026-11-27)\n\n" + "\n".join(f"### {name}\n- It.\n" for name in release.HEADINGS)


def test_the_changelog_has_a_section_of_this_version():
    text = (ROOT / "CHANGELOG.md").read_text()
    assert [problem for problem in release.changelog(text, PROJECT["version"]) if "Unreleased" not in problem] == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("1.2.0 (", "1.1.0 ("), r"no section 1\.2\.0"),
        ((" (2026-11-27)", ""), "has no date"),
        (("### Migration\n- It.\n", ""), "says nothing under ### Migration"),
        (("## 1.2.0", "## Unreleased\n\n### Added\n- More.\n\n## 1.2.0"), "lines under Unreleased; move them to 1.2.0"),
    ],
)
def test_what_a_changelog_lacks_is_named(change, problem):
    assert not list(release.changelog(GOOD, "1.2.0"))
    (found,) = release.changelog(GOOD.replace(*change), "1.2.0")
    assert re.search(problem, found)


def test_a_tree_with_changes_or_the_tag_of_this_version_is_no_release(tmp_path):
    def git(*arguments):
        said = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", *said, *arguments], cwd=tmp_path, check=True, capture_output=True)

    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "1.2.0"\n')
    git("init")
    git("add", ".")
    git("commit", "-m", "all")
    assert not list(release.tree(tmp_path))
    (tmp_path / "left.txt").write_text("")
    git("tag", "v1.2.0")
    dirty, tagged = release.tree(tmp_path)
    assert "?? left.txt" in dirty and "v1.2.0 is tagged already" in tagged


def test_metadata_that_differ_are_named(tmp_path):
    project = {name: PROJECT[name] for name in ("name", "version", "description", "requires-python", "license")}
    extras = "".join(f"Provides-Extra: {extra}\n" for extra in PROJECT["optional-dependencies"] if extra != "plot")
    said = (
        f"Name: torchds\nVersion: 0.0.1\nSummary: {project['description']}\nRequires-Python: {project['requires-python']}\n"
        f"License-Expression: MIT\nDescription-Content-Type: text/markdown\n{extras}\nno page"
    )
    with zipfile.ZipFile(tmp_path / "torchds.whl", "w") as wheel:
        wheel.writestr("torchds-0.0.1.dist-info/METADATA", said)
    version, extra, page = release.metadata(tmp_path / "torchds.whl", PROJECT)
    assert f"Version has to be '{PROJECT['version']}', got '0.0.1'" in version
    assert "no extra plot" in extra and "README is not in it" in page
