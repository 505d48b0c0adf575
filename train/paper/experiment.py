"""The digging experiment as a command: `python -m train digging`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from train.folder import Interrupted
from train.learning.run import check
from train.options import options_for
from train.paper.measured.digging import RUNS, Experiment


@dataclass
class Digging:
    """Make the digging experiment (section 6) as far as it is not there.

    Learning runs from two stiffnesses with the paper's learner and the recommended one, and trials of what they learned and
    of uniform stiffness. It takes hours, in as many sittings as you like: ended at any moment, even killed, the same command
    goes on.
    `python -m train figures --figure 15 16 17` and `python -m train claims` show what is there.
    """

    runs: int = RUNS
    """Learning runs of each learner from each start; with more than before, the missing ones are added."""
    seed: int = 0
    """Seed of the first run; each further one has the next."""
    grains: Literal["fine", "coarse"] = "fine"
    """The bed."""
    seconds: float = 15.0
    """Duration of the motion."""
    updates: int | None = None
    """Updates of a learning run; the task's own number if not given."""
    rollouts: int | None = None
    """Roll-outs of an update, likewise."""
    threads: int = 2
    """Threads of the physics; the results do not depend on them."""
    logdir: Path = Path("logs")
    """Where to write: LOGDIR/lwr_digging/experiment-SEED/."""

    def main(self) -> None:
        """Go on until all is there.

        Raises:
            InvalidArgumentError: numbers out of range.
            Interrupted: from the keyboard; the same command continues.
        """
        names = ("grains", "seconds", "updates", "rollouts", "threads")
        options = options_for("lwr_digging", **{name: getattr(self, name) for name in names})
        check(replace(options, runs=self.runs, seed=self.seed))
        folder = self.logdir / "lwr_digging" / f"experiment-{self.seed}"
        experiment = Experiment(folder, self.seed, options, self.runs)
        print(
            f"digging in {folder}: {len(experiment.missing())} of {len(experiment.names())} policies are to be made and tried"
        )
        try:
            experiment.go_on()
        except KeyboardInterrupt:
            raise Interrupted("stopped; the same command continues") from None
        print("all is there; see: python -m train figures --figure 15 16 17")
