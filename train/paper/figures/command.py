"""The figures of the paper, made again: `python -m train figures`.

A figure is drawn in the file of its section, named in the table below; what it shows is measured in the file of the same name
in `measured/`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from torchds import plotting
from torchds.errors import InvalidArgumentError
from train.folder import make_folder, write_text
from train.learning.run import check
from train.options import RunOptions
from train.paper.figures import digging, impedance, noise, stable, via_points
from train.paper.figures.base import Made
from train.paper.measured.digging import Experiment

DIGGING: dict[int, Callable[[Experiment], Made]] = {
    15: digging.figure_15,
    16: digging.figure_16,
    17: digging.figure_17,
}

FIGURES: dict[int, Callable[[int, int], Made]] = {
    1: via_points.figure_1,
    2: via_points.figure_2,
    3: via_points.figure_3,
    4: via_points.figure_4,
    5: noise.figure_5,
    6: stable.figure_6,
    7: stable.figure_7,
    8: stable.figure_8,
    9: impedance.figure_9,
    10: impedance.figure_10,
    11: impedance.figure_11,
    12: impedance.figure_12,
    13: impedance.figure_13,
    14: impedance.figure_14,
}


@dataclass
class Figures:
    """Make figures of the paper again, with a caption file of measured statistics beside each."""

    figure: tuple[int, ...] = tuple(FIGURES)
    """Numbers of the figures to make, as in the paper; 15, 16 and 17 show what `python -m train digging` has left in
    LOGDIR/lwr_digging/experiment-SEED/."""
    runs: int = 20
    """Learning runs behind a statistic."""
    seed: int = 0
    """Seed of the exploration noise."""
    logdir: Path = Path("logs")
    """Where to write: LOGDIR/figures/."""

    def main(self) -> None:
        """Make the figures.

        Raises:
            InvalidArgumentError: a number that is not among the figures, or no runs.
        """
        check(RunOptions(runs=self.runs, seed=self.seed))
        known = (*FIGURES, *DIGGING)
        if strangers := sorted(set(self.figure) - set(known)):
            raise InvalidArgumentError(
                f"no figure {', '.join(map(str, strangers))}; there are {', '.join(map(str, known))}"
            )
        folder = self.logdir / "figures"
        make_folder(folder)
        print(f"figures in {folder}")
        for number in tqdm(self.figure, desc="figures", unit="figure", dynamic_ncols=True):
            made = self.digging(number) if number in DIGGING else FIGURES[number](self.runs, self.seed)
            plotting.save(folder / f"figure-{number}.png", made.figure)
            command = f"python -m train figures --figure {number} --runs {self.runs} --seed {self.seed}"
            text = f"# Figure {number}\n\n{made.caption.strip()}\n\nMade by `{command}`.\n"
            write_text(folder / f"figure-{number}.md", text)

    def digging(self, number: int) -> Made:
        """A figure of the digging experiment that is there."""
        return DIGGING[number](Experiment(self.logdir / "lwr_digging" / f"experiment-{self.seed}", self.seed))
