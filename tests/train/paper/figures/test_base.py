"""What the figures share."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from train.paper.figures.base import boxes


def test_boxes_show_the_quartiles_and_every_run(randn):
    samples = {"a": randn(11).tolist(), "b": (randn(9) + 3).tolist()}
    axes = Figure().subplots()
    boxes(axes, samples, "cost")
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["a", "b"] and axes.get_ylabel() == "cost"
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    for i, (line, values) in enumerate(zip(dots, samples.values(), strict=True), start=1):
        assert line.get_ydata().tolist() == values
        assert np.abs(line.get_xdata() - i).max() < 0.2
    heights = [line.get_ydata()[0] for line in axes.lines if len(set(np.asarray(line.get_ydata()).tolist())) == 1]
    for values in samples.values():
        assert any(height == pytest.approx(np.median(values)) for height in heights)
