"""What docs/gallery.md shows is small, and stands beside the command that makes it."""

import re
import shlex
import sys
from pathlib import Path

import pytest

from train import __main__ as commands

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "gallery.md").read_text()
SECTIONS = re.split(r"^## ", PAGE, flags=re.M)[1:-1]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.splitlines()[0])
def test_each_picture_has_its_command_and_says_what_to_see(section):
    (language,) = re.findall(r"^```(\w+)", section, re.M)
    ((says, file),) = re.findall(r"!\[(.*?)\]\((.*?)\)", section, re.S)
    assert language in ("sh", "python") and len(says) > 20
    assert (DOCS / file).stat().st_size < 300_000
    assert len(section.split(f"({file})")[1].strip()) > 80


def test_the_pictures_of_the_page_are_small_together():
    pictures = {DOCS / file for file in re.findall(r"!\[.*?\]\((.*?)\)", PAGE, re.S)}
    assert len(pictures) >= 8 and sum(path.stat().st_size for path in pictures) < 1_000_000


@pytest.mark.parametrize("command", re.findall(r"^python -m train (.*)$", PAGE, re.M))
@pytest.mark.slow
def test_each_command_is_understood(command, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["train", *shlex.split(command), "--help"])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    assert ended.value.code == 0 and "usage" in capsys.readouterr().out


@pytest.mark.slow
def test_the_motion_of_poses_is_drawn_and_turns_as_far_as_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    space = {}
    exec(code, space)
    angle = space["x"][0, 3:].norm() * 180 / 3.14159265
    assert (tmp_path / "poses.png").stat().st_size > 10_000
    assert f"by {angle:.0f}°" in PAGE
    assert space["x"][-1].norm() < 0.3 * space["x"][0].norm()
