"""What the figures of the paper share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchds import plotting


class Made(NamedTuple):
    """A figure and the text below it, with the statistics measured while it was made."""

    figure: Figure
    caption: str


def boxes(axes: Axes, samples: Mapping[str, Sequence[float]], ylabel: str) -> None:
    """Box plots with the single runs on top."""
    axes.boxplot(list(samples.values()), tick_labels=list(samples), showfliers=False, medianprops={"color": "black"})
    for i, values in enumerate(samples.values(), start=1):
        spread = i + 0.16 * np.linspace(-1, 1, len(values))
        axes.plot(
            spread, values, "o", ms=3.5, alpha=0.5, color=plotting.TERMS[0], label="one run" if i == 1 else "_nolegend_"
        )
    axes.set_ylabel(ylabel)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8)
