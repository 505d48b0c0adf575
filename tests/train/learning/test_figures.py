"""What the pictures of a run say, read back from them."""

import numpy as np
import pytest

from train.learning import figures
from train.learning.learner import Learner
from train.options import options_for


@pytest.fixture(scope="module")
def learner():
    made = Learner(options_for("two_starts", runs=3, updates=1, rollouts=4))
    made.start()
    return made


def markers(lines):
    return {line.get_label(): line._marker.get_path().vertices for line in lines if line.get_marker() != "None"}


@pytest.mark.slow
@pytest.mark.parametrize("draw", [figures.progress, lambda learner, path: figures.motion(learner)])
def test_two_sets_of_via_points_have_two_looks_which_the_legend_shows(learner, draw):
    axes = draw(learner, learner.path).axes[-1]
    drawn, named = markers(axes.lines), markers(axes.get_legend().legend_handles)
    assert set(drawn) == set(named) == {"start", "goal", "via-points, left", "via-points, right"}
    assert all(np.array_equal(drawn[name], named[name]) for name in drawn)
    left, right = drawn["via-points, left"], drawn["via-points, right"]
    assert left.shape != right.shape or not np.allclose(left, right)


@pytest.mark.slow
def test_a_picture_of_the_progress_has_all_runs_and_what_they_began_with(learner):
    axes = figures.progress(learner, learner.path).axes[0]
    entries = [text.get_text() for text in axes.get_legend().get_texts()]
    assert entries == ["before learning", "now, 3 runs", "start", "goal", "via-points, left", "via-points, right"]
    assert axes.get_title() == "After 0 roll-outs" and "mm" in axes.get_xlabel()
