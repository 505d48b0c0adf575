"""The LASA benchmark of stable fits: `python -m train benchmark_lasa`."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

import torchds
from torchds import Bounds, Demonstrations, GMRPolicy, StableFit, metrics
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.recordings import lasa_names
from train.folder import versions, write_json
from train.lasa import report as lasa_report

METHODS = ("gmr", "none", "seds", "p-qlf")
MOTIONS = tuple(name for name in lasa_names() if not name.startswith("Multi"))
N_DEMOS, N_TRAIN = 7, 4
EVERY, FIT_EVERY = 2, 4  # of the 1000 recorded samples; of these again, for a fit
DT, N_STEPS, FIRST = 0.01, 3000, 19  # [s]; of a reproduction, which sets out from the 20th sample
REST_SPEED, REST_STEPS = 0.1, 4  # [mm/s]: a motion has ended when all its reproductions were as slow so many steps
FAR = 1000.0  # [mm] where reproductions that diverge are held
GRID, WIDENED = 16, 0.1  # starts per side of the demonstrations' box, and what is added to it on each side
TOLERANCE, HORIZON = 1.0, 100.0  # [mm], [s]: a start ends at the goal if it is as close after at most that time
CHECK, STANDSTILL = 100, 1e-3  # steps between two looks, [mm/s] that counts as rest


class Split(NamedTuple):
    """One repetition: M motions with their training and test demonstrations, and the test ones as tensors."""

    train: list[Demonstrations]
    test: list[Demonstrations]
    x: Tensor  # (M, S, T, 2) [mm]
    v: Tensor  # (M, S, T, 2) [mm/s]
    box: Tensor  # (2, M, 2) corners of all demonstrations


@dataclass
class BenchmarkLasa:
    """Fit the 26 single motions of the LASA set, and measure fits, reproductions and stability on unseen demonstrations."""

    repetitions: int = 10
    """Repetitions; with the published split they differ in the start of the EM fit."""
    motions: tuple[str, ...] = MOTIONS
    """Motions to fit; all 26 single ones by default."""
    split: Literal["published", "random"] = "published"
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
        """
        if self.repetitions < 1 or not self.motions:
            raise InvalidArgumentError(
                f"at least one repetition and one motion are needed, got {self.repetitions} and {len(self.motions)}"
            )
        for name in self.motions:
            if name not in MOTIONS:
                raise UnknownNameError("single LASA motion", name, MOTIONS)
        folder = self.logdir / "benchmark_lasa"
        folder.mkdir(parents=True, exist_ok=True)
        began = time.perf_counter()
        rows: list[dict] = []
        shown: tuple[Split, StableFit] | None = None
        with tqdm(total=self.repetitions * len(METHODS), unit="batch", dynamic_ncols=True) as bar:
            for r in range(self.repetitions):
                split = self.draw(r)
                for method, fit, seconds in fits(split, self.seed + r):
                    bar.set_postfix_str(f"repetition {r + 1}, {method}")
                    measured = evaluate(method, fit, split) | {"seconds": [seconds] * len(self.motions)}
                    for i, motion in enumerate(self.motions):
                        row = {"method": method, "motion": motion, "repetition": r}
                        rows.append(row | {name: values[i] for name, values in measured.items()})
                    if r == 0 and method == "p-qlf":
                        shown = split, fit
                    bar.update()
        total = time.perf_counter() - began
        options = asdict(self) | {"logdir": str(self.logdir)}
        text = lasa_report.page(rows, options, versions(), total)
        lasa_report.write_tables(folder, rows)
        write_json(folder / "options.json", {"options": options, "versions": versions(), "seconds": round(total, 1)})
        (folder / "benchmark_lasa.md").write_text(text)
        if shown is not None:
            lasa_report.fields(self.motions, *shown, rows).savefig(folder / "fields.png", dpi=110)
        print(text.split("## By motion")[0])
        print(f"tables and figure in {folder}")

    def draw(self, repetition: int) -> Split:
        """The demonstrations of one repetition, every 2nd sample of them."""
        generator = torch.Generator().manual_seed(self.seed + repetition)
        train, test, corners = [], [], []
        for name in self.motions:
            demos = torchds.load_lasa(name).every(EVERY)
            corners.append(demos.stacked().x.aminmax(dim=0))
            if self.split == "random":
                order = torch.randperm(N_DEMOS, generator=generator).tolist()
                demos = sum((demos[i : i + 1] for i in order[1:]), demos[order[0] : order[0] + 1])
            train.append(demos[:N_TRAIN].every(FIT_EVERY))
            test.append(demos[N_TRAIN:])
        x, v = (torch.stack([torch.stack([getattr(demo, part) for demo in demos]) for demos in test]) for part in "xv")
        return Split(train, test, x, v, torch.stack([torch.stack(sides) for sides in zip(*corners, strict=True)]))


def fits(split: Split, seed: int) -> Iterator[tuple[str, StableFit, float]]:
    """Every method's fit of all motions in one batch, and the seconds it took per motion, EM and BIC included."""
    goal = torch.zeros(len(split.train), 2, dtype=torch.float64)
    began = time.perf_counter()
    start = torchds.fit_mixtures(split.train, "bic", goal=goal, seed=seed)
    shared = time.perf_counter() - began
    identity = torch.eye(2, dtype=torch.float64).expand(len(goal), -1, -1)
    n = (start.priors > 0).sum(-1)
    yield "gmr", StableFit(GMRPolicy.from_mixture(start, 2), goal, identity, goal[:, 0], n), shared / len(goal)
    for condition in ("none", "seds", "p-qlf"):
        began = time.perf_counter()
        fit = torchds.fit_stable(split.train, condition=condition, goal=goal, start=start)
        yield condition, fit, (shared + time.perf_counter() - began) / len(goal)


@torch.no_grad()
def evaluate(method: str, fit: StableFit, split: Split) -> dict[str, list]:
    """All measures, one value per motion; the mean over the test demonstrations where a measure is of one of them."""
    policy = fit.policy
    predicted = policy(split.x)
    certificate = fit.certificate()
    measured = {
        "K": fit.n_components,
        "rmse": metrics.velocity_rmse(predicted, split.v).mean(-1),
        "edot": metrics.direction_error(predicted, split.v).mean(-1),
        **reproduce(policy, split),
        "grid": share_at_goal(policy, split.box, fit.goal),
        "certified": certificate.stable & torch.tensor(method in ("seds", "p-qlf")),
        "margin": certificate.margin,
    }
    return {name: values.tolist() for name, values in measured.items()}


def reproduce(policy: GMRPolicy, split: Split) -> dict[str, Tensor]:
    """DTWD [mm] and swept area [mm²] of reproductions of the test demonstrations, mean of each motion.

    The published convention: Euler steps of 0.01 s from the 20th sample until all reproductions of a motion were slower
    than 0.1 mm/s for 4 steps, at most 3000; DTWD against the whole demonstration. The area is that to the demonstration
    from the 20th sample on.
    """
    path = torchds.rollout(policy, split.x[:, :, FIRST], N_STEPS, DT, starts="per_policy", stop=Bounds(-FAR, FAR))
    slow = (path.v.abs() < REST_SPEED).flatten(3).all(-1).all(1)  # (M, T)
    rested = slow.unfold(-1, REST_STEPS, 1).all(-1).long()
    length = torch.where(rested.any(-1), rested.argmax(-1) + REST_STEPS, N_STEPS)
    dtwd, area = torch.zeros(2, *split.x.shape[:2], dtype=torch.float64)
    for i, n in enumerate(length.tolist()):
        for s, demo in enumerate(split.x[i]):
            dtwd[i, s] = metrics.dtwd(path.x[i, s, :n], demo)
            area[i, s] = metrics.swept_area(path.x[i, s, :n], demo[FIRST:])
    return {"dtwd": dtwd.mean(-1), "swept_area": area.mean(-1)}


def share_at_goal(policy: GMRPolicy, box: Tensor, goal: Tensor) -> Tensor:
    """The share of a 16 × 16 grid of starts that ends within 1 mm of the goal, `(M,)`.

    The grid covers the demonstrations' box, widened by a tenth on each side. Euler steps of 0.01 s for 100 s, in float32;
    starts that have arrived, rest elsewhere or are 1 m away leave the batch before.
    """
    (low, high), M = box.float(), len(goal)
    side = torch.linspace(-WIDENED, 1 + WIDENED, GRID)
    x = (low.unsqueeze(1) + torch.cartesian_prod(side, side) * (high - low).unsqueeze(1)).flatten(0, 1)  # (M 256, 2)
    motion = torch.arange(M).repeat_interleave(GRID**2)
    policy, goal = (
        copy.deepcopy(policy).float()[motion],
        goal.float()[motion],
    )  # one for each start: they leave one by one
    n_arrived = torch.zeros(M, dtype=torch.long)
    for i in range(1, round(HORIZON / DT) + 1):
        v = policy(x)
        x = x + DT * v
        if i % CHECK:
            continue
        arrived = torch.linalg.vector_norm(x - goal, dim=-1) < TOLERANCE
        n_arrived += torch.bincount(motion[arrived], minlength=M)
        going = ~(arrived | (v.abs() < STANDSTILL).all(-1) | (x.abs() > FAR).any(-1))
        if not going.any():
            break
        x, motion, policy, goal = x[going], motion[going], policy[going], goal[going]
    return n_arrived.double() / GRID**2
