"""The figures of the paper, after two updates in place of all: each is drawn, and its caption says what was measured."""

import re
import sys

import pytest
from matplotlib.image import imread

from torchds.errors import InvalidArgumentError
from train import __main__ as commands
from train.paper.figures.command import FIGURES, Figures
from train.paper.measured import stable
from train.paper.measured.base import learned

LEARNED = {2: 2, 3: 4, 4: 1, 10: 1, 11: 3, 13: 1, 14: 2}  # figure -> learning batches behind it
TOGETHER = [(10, 11), (13, 14)]  # which share what was learned: the second learns what the first did not


@pytest.fixture
def quick(monkeypatch):
    """Two updates, whatever the task says; returns the tasks that were learned."""
    asked = []

    def two(options, *_):
        asked.append(options.task)
        return 2

    monkeypatch.setattr("train.learning.learner.n_updates", two)
    for kept in (learned, stable.variant):
        kept.cache_clear()
    yield asked
    for kept in (learned, stable.variant):
        kept.cache_clear()


def drawn(folder, number):
    """Whether figure and caption in a folder are complete."""
    image = imread(folder / f"figure-{number}.png")[..., :3]
    assert min(image.shape[:2]) > 500
    assert image.std() > 0.02  # there is something on it
    title, *body, made = [line for line in (folder / f"figure-{number}.md").read_text().splitlines() if line]
    assert title == f"# Figure {number}"
    assert made == f"Made by `python -m train figures --figure {number} --runs 2 --seed 3`."
    caption = " ".join(body)
    assert len(caption) > 100
    assert not re.search(r"\bnan\b|\binf\b", caption)
    if number != 1:  # which shows, and measures nothing
        assert re.search(r"\d", caption)
    return True


@pytest.mark.parametrize("numbers", [*((n,) for n in FIGURES if n not in sum(TOGETHER, (9, 12))), *TOGETHER])
@pytest.mark.slow
def test_a_figure_is_drawn_and_its_caption_has_numbers_and_the_command(numbers, quick, tmp_path):
    """Those of one experiment learn it once, also by one command after the other."""
    folder = tmp_path / "figures"
    for number in numbers:
        Figures(figure=(number,), runs=2, seed=3, logdir=tmp_path).main()
        assert drawn(folder, number)
        assert len(quick) == LEARNED.get(number, len(quick))
    assert {file.name for file in folder.iterdir()} == {f"figure-{n}.{end}" for n in numbers for end in ("png", "md")}
    if numbers in TOGETHER:
        assert len(set(quick)) == 1


@pytest.mark.slow
def test_the_command_makes_the_figures_that_are_asked_for(quick, tmp_path, monkeypatch, capsys):
    asked = ["figures", "--figure", "9", "12", "--runs", "2", "--seed", "3", "--logdir", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["train", *asked])
    assert commands.main() == 0
    assert f"figures in {tmp_path / 'figures'}" in capsys.readouterr().out
    assert {file.stem for file in (tmp_path / "figures").iterdir()} == {"figure-9", "figure-12"}
    assert drawn(tmp_path / "figures", 9) and drawn(tmp_path / "figures", 12)


def test_numbers_out_of_range_are_refused_before_anything_is_made(tmp_path):
    with pytest.raises(InvalidArgumentError, match=r"^no figure 98, 99; there are 1, 2, 3, 4, 5"):
        Figures(figure=(1, 99, 98), logdir=tmp_path / "new").main()
    with pytest.raises(InvalidArgumentError, match="--runs has to be at least 1, got 0"):
        Figures(figure=(1,), runs=0, logdir=tmp_path / "new").main()
    assert not (tmp_path / "new").exists()
