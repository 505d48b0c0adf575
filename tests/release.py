"""`python -m tests.release DIST`: whether what stands here is the release of its version; `make release-check` asks it last."""

import email
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEADINGS = ("Added", "Changed", "Fixed", "Migration")


def version(root=ROOT):
    """That of pyproject.toml."""
    return tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]


def tree(root=ROOT):
    """What keeps the tree from being the commit that is tagged."""
    status = subprocess.run(
        ["git", "status", "--porcelain"], cwd=root, check=True, capture_output=True, text=True
    ).stdout
    if status:
        yield f"the tree is not clean; commit these, or remove them:\n{status.rstrip()}"
    if subprocess.run(["git", "tag", "--list", f"v{version(root)}"], cwd=root, capture_output=True, text=True).stdout:
        yield f"v{version(root)} is tagged already; choose the next version"


def changelog(text, number):
    """What a reader of the release would miss in the changelog."""
    sections = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", text, re.M | re.S))
    if sections.get("Unreleased", "").strip():
        yield f"the changelog has lines under Unreleased; move them to {number}"
    titles = [title for title in sections if title.split(" ")[0] == number]
    if not titles:
        yield f"the changelog has no section {number}"
        return
    if not re.fullmatch(re.escape(number) + r" \(\d{4}-\d\d-\d\d\)", titles[0]):
        yield f"the section {titles[0]} of the changelog has no date; write ## {number} (YYYY-MM-DD)"
    parts = dict(re.findall(r"^### (.*?)\n(.*?)(?=^### |\Z)", sections[titles[0]], re.M | re.S))
    for heading in HEADINGS:
        if not parts.get(heading, "").strip():
            yield f"the section {titles[0]} of the changelog says nothing under ### {heading}"


def metadata(wheel, project):
    """What is wrong with what pip and an index read of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        said = email.message_from_bytes(archive.read(name))
    expected = {
        "Name": project["name"],
        "Version": project["version"],
        "Summary": project["description"],
        "Requires-Python": project["requires-python"],
        "License-Expression": project["license"],
        "Description-Content-Type": "text/markdown",
    }
    for field, value in expected.items():
        if said[field] != value:
            yield f"{wheel.name}: {field} has to be {value!r}, got {said[field]!r}"
    if missing := set(project["optional-dependencies"]) - set(said.get_all("Provides-Extra", [])):
        yield f"{wheel.name}: no extra {', '.join(sorted(missing))}"
    if "## " not in said.get_payload():
        yield f"{wheel.name}: the README is not in it"


def main(dist):
    """Print what is wrong; returns how much."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found = [*tree(), *changelog((ROOT / "CHANGELOG.md").read_text(), project["version"])]
    wheels = sorted(dist.glob("*.whl"))
    found += [problem for wheel in wheels for problem in metadata(wheel, project)]
    if len(wheels) != 1 or len(list(dist.glob("*.tar.gz"))) != 1:
        found.append(f"{dist} has to hold one wheel and one sdist, got {sorted(path.name for path in dist.iterdir())}")
    for problem in found:
        print(f"not ready: {problem}")
    if not found:
        print(f"torchds {project['version']} is ready: git tag -a v{project['version']}, and upload {dist}/")
    return len(found)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])) > 0)
