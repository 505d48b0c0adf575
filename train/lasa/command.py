"""The LASA benchmark of stable fits: `python -m train benchmark_lasa`."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tqdm import tqdm

from torchds import StableFit, plotting
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.files import write_json
from train.folder import make_folder, versions, write_text
from train.lasa import report
from train.lasa.measures import FITS, Split, SplitKind, draw, evaluate, fits, single_motions
from train.options import check_seed


@dataclass
class BenchmarkLasa:
    """Fit the 26 single motions of the LASA set, and measure fits, reproductions and stability on unseen demonstrations."""

    repetitions: int = 10
    """Repetitions; with the published split they differ in the start of the EM fit."""
    motions: tuple[str, ...] | None = None
    """Motions to fit; all 26 single ones if not given."""
    split: SplitKind = "published"
    """Demonstrations 1-4 train and 5-7 test, as in the published evaluation; or four drawn anew in every repetition."""
    seed: int = 0
    """Seed of the first repetition, counted up from there."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where to write: LOGDIR/benchmark_lasa/."""

    def main(self) -> None:
        """Run the benchmark; print the table by method, write tables and figure.

        Raises:
            InvalidArgumentError: fewer than one repetition, or no motion.
            UnknownNameError: a motion that is not among the 26.
            MissingPackageError: without the extra "lasa".
        """
        check_seed(self.seed, bits=31)
        motions = self.names()
        folder = self.logdir / "benchmark_lasa"
        make_folder(folder)
        began = time.perf_counter()
        rows: list[dict] = []
        shown: tuple[Split, StableFit] | None = None
        with tqdm(total=self.repetitions * len(FITS), unit="batch", dynamic_ncols=True) as bar:
            for r in range(self.repetitions):
                split = draw(motions, self.split, self.seed + r)
                for method, fit, seconds in fits(split, self.seed + r):
                    bar.set_postfix_str(f"repetition {r + 1}, {method}")
                    measured = evaluate(method, fit, split) | {"seconds": [seconds] * len(motions)}
                    for i, motion in enumerate(motions):
                        row = {"method": method, "motion": motion, "repetition": r}
                        rows.append(row | {name: values[i] for name, values in measured.items()})
                    if r == 0 and method == "p-qlf":
                        shown = split, fit
                    bar.update()
        total = time.perf_counter() - began
        options = asdict(self) | {"motions": motions, "logdir": str(self.logdir)}
        text = report.page(rows, options, versions(), total)
        report.write_tables(folder, rows)
        write_json(folder / "options.json", {"options": options, "versions": versions(), "seconds": round(total, 1)})
        write_text(folder / "benchmark_lasa.md", text)
        if shown is not None:
            plotting.save(folder / "fields.png", report.fields(motions, *shown, rows), dpi=110)
        print(text.split("## By motion")[0])
        print(f"tables and figure in {folder}")

    def names(self) -> tuple[str, ...]:
        """The motions to fit, checked."""
        known = single_motions()
        motions = known if self.motions is None else self.motions
        if self.repetitions < 1 or not motions:
            raise InvalidArgumentError(
                f"--repetitions has to be at least 1, and --motions to name at least one, got {self.repetitions} and "
                f"{len(motions)}"
            )
        for name in motions:
            if name not in known:
                raise UnknownNameError("single LASA motion", name, known)
        return motions
