"""What is measured of fits to the LASA motions, and the data that they are fitted to and measured on."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Literal, NamedTuple

import torch
from torch import Tensor

import torchds
from torchds import Bounds, Demonstrations, GMRPolicy, StableFit, metrics
from torchds.recordings import lasa_names

FITS = ("gmr", "none", "seds", "p-qlf")
"""The ways to fit, in the order of the tables."""
N_DEMOS, N_TRAIN = 7, 4
EVERY, FIT_EVERY = 2, 4  # of the 1000 recorded samples; of these again, for a fit
DT, N_STEPS, FIRST = 0.01, 3000, 19  # [s]; of a reproduction, which sets out from the 20th sample
REST_SPEED, REST_STEPS = 0.1, 4  # [mm/s]: a motion has ended when all its reproductions were as slow so many steps
FAR = 1000.0  # [mm] where reproductions that diverge are held
GRID, WIDENED = 16, 0.1  # starts per side of the demonstrations' box, and what is added to it on each side
TOLERANCE, HORIZON = 1.0, 100.0  # [mm], [s]: a start ends at the goal if it is as close after at most that time
CHECK, STANDSTILL = 100, 1e-3  # steps between two looks, [mm/s] that counts as rest

SplitKind = Literal["published", "random"]


@cache
def single_motions() -> tuple[str, ...]:
    """The names of the 26 motions that are not made of several.

    Raises:
        MissingPackageError: without the extra "lasa".
    """
    return tuple(lasa_names(single=True))


class Split(NamedTuple):
    """One repetition: M motions with their training and test demonstrations, and the test ones as tensors."""

    train: list[Demonstrations]
    test: list[Demonstrations]
    x: Tensor  # (M, S, T, 2) [mm]
    v: Tensor  # (M, S, T, 2) [mm/s]
    box: Tensor  # (2, M, 2) corners of all demonstrations


def draw(motions: Sequence[str], kind: SplitKind, seed: int) -> Split:
    """The demonstrations of one repetition, every 2nd sample of them.

    Args:
        motions: M names.
        kind: "published": demonstrations 1-4 train and 5-7 test. "random": four drawn for training.
        seed: of the drawing.
    """
    generator = torch.Generator().manual_seed(seed)
    train, test, corners = [], [], []
    for name in motions:
        demos = torchds.load_lasa(name).every(EVERY)
        corners.append(demos.stacked().x.aminmax(dim=0))
        if kind == "random":
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


@torch.no_grad()
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


@torch.no_grad()
def share_at_goal(policy: GMRPolicy, box: Tensor, goal: Tensor) -> Tensor:
    """The share of a 16 × 16 grid of starts that ends within 1 mm of the goal, `(M,)`.

    The grid covers the demonstrations' box, widened by a tenth on each side. Euler steps of 0.01 s for 100 s, in float32;
    starts that have arrived, rest elsewhere or are 1 m away leave the batch before.
    """
    (low, high), M = box.float(), len(goal)
    side = torch.linspace(-WIDENED, 1 + WIDENED, GRID)
    x = (low.unsqueeze(1) + torch.cartesian_prod(side, side) * (high - low).unsqueeze(1)).flatten(0, 1)  # (M 256, 2)
    motion = torch.arange(M).repeat_interleave(GRID**2)
    policy, goal = copy.deepcopy(policy).float()[motion], goal.float()[motion]  # for each start: they leave one by one
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
