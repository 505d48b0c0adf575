"""The figures of the paper, after two updates in place of all: each is drawn, and its caption says what was measured."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.image import imread

from torchds.errors import InvalidArgumentError
from train.paper.figures.command import FIGURES, Figures
from train.paper.measured import stable
from train.paper.measured.base import learned

ROOT = Path(__file__).parents[4]
LEARNED = {2: 2, 3: 4, 4: 1, 10: 1, 11: 3, 13: 1, 14: 2}  # figure -> learning batches behind it


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


@pytest.mark.parametrize("number", FIGURES)
@pytest.mark.slow
def test_a_figure_is_drawn_and_its_caption_has_numbers_and_the_command(number, quick, tmp_path):
    Figures(figure=(number,), runs=2, seed=3, logdir=tmp_path).main()
    folder = tmp_path / "figures"
    assert {file.name for file in folder.iterdir()} == {f"figure-{number}.png", f"figure-{number}.md"}
    image = imread(folder / f"figure-{number}.png")[..., :3]
    assert min(image.shape[:2]) > 500
    assert image.std() > 0.02  # there is something on it
    title, *body, made = [line for line in (folder / f"figure-{number}.md").read_text().splitlines() if line]
    assert title == f"# Figure {number}"
    assert made == f"Made by `python -m train figures --figure {number} --runs 2 --seed 3`."
    caption = " ".join(body)
    assert len(caption) > 100
    assert not re.search(r"\bnan\b|\binf\b", caption)
    assert len(quick) == LEARNED.get(number, len(quick))
    if number != 1:  # which shows, and measures nothing
        assert re.search(r"\d", caption)


@pytest.mark.slow
def test_the_figures_of_one_experiment_learn_it_once(quick, tmp_path):
    Figures(figure=(10, 11, 13, 14), runs=2, logdir=tmp_path).main()
    assert sorted(quick) == ["divergent_field"] * 3 + ["half_plane_force"] * 2


def test_a_number_that_is_no_figure_is_refused_before_anything_is_made(tmp_path):
    with pytest.raises(InvalidArgumentError, match=r"^no figure 98, 99; there are 1, 2, 3, 4, 5"):
        Figures(figure=(1, 99, 98), logdir=tmp_path / "new").main()
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_the_command_makes_a_figure(tmp_path):
    command = [sys.executable, "-m", "train", "figures", "--figure", "9", "12", "--logdir", str(tmp_path)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert f"figures in {tmp_path / 'figures'}" in ended.stdout
    assert {file.stem for file in (tmp_path / "figures").iterdir()} == {"figure-9", "figure-12"}
