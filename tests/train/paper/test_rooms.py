"""Three rooms: what is measured, drawn and judged, with one file name for each section."""

import ast
from pathlib import Path

import pytest

from train.paper.claims.command import CLAIMS
from train.paper.figures.command import DIGGING, FIGURES

PAPER = Path(__file__).parents[3] / "train" / "paper"
SECTIONS = {"via_points", "noise", "stable", "impedance", "digging"}
DRAWING = ("matplotlib", "torchds.plotting", "train.paper.figures", "train.learning.figures", "train.learning.album")


def imported(path):
    """What a file imports, names within packages included."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("room", ["measured", "figures", "claims"])
def test_each_section_has_its_file(room):
    assert {path.stem for path in (PAPER / room).glob("*.py")} >= SECTIONS


@pytest.mark.parametrize(
    ("room", "kept_out"),
    [("measured", (*DRAWING, "train.paper.claims")), ("claims", DRAWING), ("figures", ("train.paper.claims",))],
)
def test_measuring_drawing_and_judging_stand_apart(room, kept_out):
    for path in (PAPER / room).glob("*.py"):
        assert not [name for name in imported(path) if name.startswith(kept_out)], path


def test_each_figure_and_claim_stands_in_the_file_of_its_section():
    homes = {number: function.__module__ for number, function in (FIGURES | DIGGING).items()}
    first = {"via_points": 1, "noise": 5, "stable": 6, "impedance": 9, "digging": 15}
    for number, home in homes.items():
        section = [name for name, start in first.items() if start <= number][-1]
        assert home == f"train.paper.figures.{section}"
    sections = {"3": ["via_points"], "4": ["noise", "stable"], "5": ["impedance"], "6": ["digging"], "7": ["limits"]}
    for claim in CLAIMS.values():
        name = claim.measure.__module__.rsplit(".", 1)[-1]
        assert name in sections[claim.where[0]] or name == "base"  # `each` makes one of two
