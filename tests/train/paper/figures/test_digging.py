"""Figures 16 and 17 of an experiment that never was: what there is of it, and a word where there is none."""

import numpy as np
import pytest

from torchds.errors import InvalidArgumentError
from train.paper.figures import digging
from train.paper.measured.digging import Experiment


def test_curves_of_the_runs_that_are_there_are_drawn_and_summed_up(dug):
    made = digging.figure_16(dug)
    titles = [axes.get_title() for axes in made.figure.axes]
    assert [title.endswith("5 run(s)") for title in titles] == [False, True, False, False]
    assert "- as in the paper, 400 N/m, 5 run(s)" in made.caption and "gravel -1.99 → -2.09" in made.caption


def test_learned_policies_stand_beside_uniform_ones_with_a_test_over_runs(dug):
    made = digging.figure_17(dug)
    line, *_ = made.figure.axes[0].get_lines()
    assert line.get_ydata().min() == pytest.approx(2.006) and "mean of 25 trials" in line.get_label()
    assert "- learned from 150 N/m, recommended: 5 run(s), 1.01 [1, 1.01], against 2.01 [2, 2.01]" in made.caption
    assert "and after 40 roll-outs of learning" in made.caption
    assert made.caption.count("p = 4.0e-03, Cliff's δ = -1.00") == 4  # 5 below 5, the least there is
    totals = np.add.outer(0.003 * np.arange(5), 2 + 0.01 * np.arange(-2, 3))
    assert (
        f"| uniform, 250 N/m | {totals.mean():.2f} ± {totals.std(ddof=1):.2f} | 2.5 ± 0.0 | 1.26 ± 0.02 |"
        in made.caption
    )
    assert (
        "| learned from 150 N/m, recommended | 1.01 ± 0.00 | 4.0 ± 0.0 | 0.81 ± 0.00 | 7.3 ± 0.0 | 222 ± 2 |"
        in made.caption
    )


@pytest.mark.parametrize("figure", [digging.figure_15, digging.figure_16, digging.figure_17])
def test_without_an_experiment_it_says_what_makes_one(figure, tmp_path):
    with pytest.raises(InvalidArgumentError, match="`python -m train digging` makes it"):
        figure(Experiment(tmp_path, 0))


def test_a_trial_that_failed_does_not_make_its_stiffness_the_best(dug, monkeypatch):
    recorded = dug.recorded()
    recorded["uniform-250-0"]["total"][1] = float("nan")
    recorded["recommended-150-4"]["total"][0] = float("nan")
    monkeypatch.setattr(Experiment, "recorded", lambda experiment: recorded)
    caption = digging.figure_17(dug).caption
    assert "| uniform, 250 N/m | inf ± nan |" in caption
    assert (
        "recommended: 5 run(s), 1.01 [1, 1.01], against 2.51 [2.5, 2.51] of the best uniform stiffness (200 N/m)"
        in caption
    )
