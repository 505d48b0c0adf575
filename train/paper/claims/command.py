"""Every claim of the paper, measured: `python -m train claims`.

A claim is judged in the file of its section, `claims/via_points.py` to `claims/limits.py`; what it needs is measured in
`measured/`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tqdm import tqdm

import tasks
import torchds
import train
from torchds.errors import FileError, UnknownNameError
from torchds.files import read_sealed, write_sealed
from train.folder import Interrupted, make_folder, versions, write_text
from train.learning.run import check
from train.options import RunOptions
from train.paper.claims import digging, impedance, limits, noise, report, stable, via_points
from train.paper.claims.base import Check, Claim
from train.paper.measured.base import Setting
from train.paper.measured.digging import Experiment

SECTIONS = (via_points, noise, stable, impedance, digging, limits)
CLAIMS: dict[str, Claim] = {claim.id: claim for section in SECTIONS for claim in section.CLAIMS}


@cache
def source() -> str:
    """A digest of the code that a result depends on, and of the libraries below it."""
    digest = hashlib.sha256(json.dumps(versions()).encode())
    for package in (torchds, tasks, train):
        folder = Path(str(package.__file__)).parent
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass
class Claims:
    """Measure the claims of the paper: one row each, with statistics and a verdict.

    What was measured with the same options and the same code is not measured again.
    """

    only: tuple[str, ...] = ()
    """Claims to measure; all if not given. The table shows their names."""
    runs: int = 20
    """Learning runs behind a statistic, in one batch."""
    seed: int = 0
    """Seed of the exploration noise."""
    keep: Path | None = None
    """Write the page to this file, too."""
    logdir: Path = Path("logs")
    """Where to write: LOGDIR/claims/. The rows about digging take what `python -m train digging` has left beside it, in
    LOGDIR/lwr_digging/experiment-SEED/."""

    def main(self) -> list[report.Judged]:
        """Measure what is missing, write claims.md and claims.csv, print the table, and return its rows.

        Raises:
            UnknownNameError: a claim that does not exist.
            InvalidArgumentError: numbers out of range.
            Interrupted: from the keyboard; the same command continues.
        """
        for name in self.only:
            if name not in CLAIMS:
                raise UnknownNameError("claim", name, CLAIMS)
        check(RunOptions(runs=self.runs, seed=self.seed))
        experiment = Experiment(self.logdir / "lwr_digging" / f"experiment-{self.seed}", self.seed)
        setting = Setting(self.runs, self.seed, experiment)
        folder = self.logdir / "claims"
        make_folder(folder)
        rows = []
        with tqdm(self.only or tuple(CLAIMS), desc="claims", unit="claim", dynamic_ncols=True) as bar:
            try:
                for name in bar:
                    bar.set_postfix_str(name)
                    rows.append(
                        report.Judged(CLAIMS[name], self.checks(CLAIMS[name], setting, folder), self.command(name))
                    )
            except KeyboardInterrupt:
                raise Interrupted("stopped; the same command continues") from None
        report.write_csv(folder / "claims.csv", rows)
        page = report.page(rows, self.runs, self.command(*self.only))
        for path in (folder / "claims.md", *(() if self.keep is None else (self.keep,))):
            make_folder(path.parent)
            write_text(path, page)
        print(report.terminal(rows, self.runs))
        print(f"claims.md and claims.csv in {folder}")
        return rows

    def checks(self, claim: Claim, setting: Setting, folder: Path) -> list[Check]:
        """What was measured for a claim: kept from before, or new."""
        if not claim.simulated:
            return claim.measure(setting)
        path, key = folder / f"{claim.id}.json", {"runs": self.runs, "seed": self.seed, "source": source()}
        kept = {}
        with contextlib.suppress(FileError):  # not there, damaged, or of an older version: measured again
            kept = read_sealed(path)
        if kept.get("key") != key:
            kept = {"key": key, "checks": [check._asdict() for check in claim.measure(setting)]}
            write_sealed(path, kept)
        return [Check(**fields) for fields in kept["checks"]]

    def command(self, *names: str) -> str:
        """What measures claims again, all of them without names."""
        only = f" --only {' '.join(names)}" if names else ""
        first = "python -m train digging; " if names and not any(CLAIMS[name].simulated for name in names) else ""
        return f"{first}python -m train claims{only} --runs {self.runs} --seed {self.seed}"
