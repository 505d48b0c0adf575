"""The claims of section 5: stiffness learned with the motion (Figs 9 to 14), and the controller."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from tasks import DivergentField
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass
from torchds.rollouts import Rollout, rollout
from train.paper.claims.base import Check, Claim, changes, counted, lower, within
from train.paper.measured.base import Setting, course, early_share, via_distances
from train.paper.measured.impedance import (
    CRITICAL,
    STEPS,
    before_learning,
    divergent,
    final,
    half_plane,
    off_nominal,
    overshoot,
    pushed,
    settling,
    step_response,
    stiffness_by_half,
    via_points,
)
from train.paper.measured.stable import watched

N_TARGETS, MOVED = 20, 2.0  # targets; their distance from the old one
FORMS: tuple[Literal["implicit"], Literal["explicit"]] = ("implicit", "explicit")
OVERSHOOT = 0.01  # of a step in the reference
DT, LATE = 0.1, 3  # time step of the force-field tasks [s]; so many of them later than the closed form


# ------------------------------------------------------------------ sections 5.1 and 5.2


@torch.no_grad()
def moving_target(setting: Setting) -> list[Check]:
    """Learned stable policies whose target jumps half-way, to each of a ring of places."""
    learner = watched(setting.runs, setting.seed).learner
    task = learner.task
    motion = task.motion()
    angles = 2 * torch.pi * torch.arange(N_TARGETS, dtype=torch.float64) / N_TARGETS
    targets = task.scene().goal + MOVED * torch.stack([angles.cos(), angles.sin()], -1)
    half = motion.n_steps // 2 * motion.dt

    def shift(t: float) -> Tensor:
        return torch.where(torch.tensor(t < half), torch.zeros_like(targets), targets)

    n_steps = motion.n_steps // 2 + STEPS
    x = rollout(learner.policy, motion.x0.expand(N_TARGETS, 2), n_steps, motion.dt, shift=shift).x
    distance = (x[..., motion.n_steps // 2 :, :] - targets.unsqueeze(-2)).norm(dim=-1)  # (runs, N_TARGETS, STEPS + 1)
    nearer = (distance.diff(dim=-1) <= 0).all(-1)
    arrived = distance[..., -1] <= 0.01 * distance[..., 0]
    return [
        counted("motions that come nearer to the new target in every step", int(nearer.sum()), nearer.numel()),
        counted(
            f"motions that end within 1 % of the distance, {STEPS * motion.dt:g} s later",
            int(arrived.sum()),
            arrived.numel(),
        ),
    ]


def damping(setting: Setting) -> list[Check]:
    """Overshoot over a step of the reference, and when the mass settles behind it, at 41 constant stiffnesses."""
    stiffness = torch.logspace(-1, 3, 41, dtype=torch.float64)[:, None]  # what the force-field tasks allow
    mass = PointMass(mass=1.0, damping=0.0)
    latest = CRITICAL / (stiffness / mass.mass).sqrt() + LATE * DT
    responses = [step_response(ImpedanceControlled(mass, form=form), stiffness, DT) for form in FORMS]
    good = {
        "with less than 1 % overshoot": [overshoot(x) <= OVERSHOOT for x in responses],
        "that settle in time": [settling(x, DT) <= latest for x in responses],
    }
    other = "if the controller looks at the state before the step"
    return [counted(f"stiffnesses {s} ({int(b.sum())} {other})", int(a.sum()), len(a)) for s, (a, b) in good.items()]


# ------------------------------------------------------------------ the divergent field


@torch.no_grad()
def disturbed(setting: Setting) -> list[Check]:
    """How far reference and point mass are from the nominal path, before learning."""
    task, path = before_learning("divergent_field")
    assert isinstance(task, DivergentField)
    reference, actual = (off_nominal(task, x) for x in (path.reference, path.x))
    return [
        within("largest distance of the reference from the nominal path [m]", float(reference.max()), low=0.1),
        within("that of the point mass, over it", float(actual.max() / reference.max()), low=1.1),
    ]


def falls_of_both(setting: Setting) -> list[Check]:
    """Stiffness cost and via-point cost, before learning and after it."""
    learner = divergent(setting.runs, setting.seed)
    return [
        changes(f"{term.replace('_', '-')} cost", course(learner, term)[0], course(learner, term)[-1])
        for term in ("stiffness", "via_points")
    ]


@torch.no_grad()
def softer_and_closer(setting: Setting) -> list[Check]:
    """The stiffness applied along the motion, and run by run the distance to the via-points."""
    learner = divergent(setting.runs, setting.seed)
    path, task = final(learner), learner.task
    before = via_distances(task.rollout(learner.initial).x, via_points(task)).mean()
    closer = via_distances(path.x, via_points(task)).mean(-1) < before
    assert isinstance(task, DivergentField)
    mean = path.plant.stiffness[..., 1:, :].mean((-2, -1))
    return [
        changes("mean stiffness along the motion [N/m]", task.initial_stiffness, mean.numpy()),
        counted("runs whose motion is nearer to the via-points, on average", int(closer.sum()), len(closer), 0.5),
    ]


def together(setting: Setting) -> list[Check]:
    """Final costs of learning motion and stiffness, against learning one of them alone."""
    both = course(divergent(setting.runs, setting.seed))[-1]
    return [
        lower(
            f"final cost, both below {name} alone",
            both,
            course(divergent(setting.runs, setting.seed, learn=name))[-1],
        )
        for name in ("motion", "stiffness")
    ]


# ------------------------------------------------------------------ the half-plane force


@torch.no_grad()
def missed(setting: Setting) -> list[Check]:
    """Distance from the reference's path, and from the via-points, without and with the force, before learning."""
    task, path = before_learning("half_plane_force")
    away = (path.x[..., None, :] - path.reference[0]).norm(dim=-1).amin(-1).amax(-1)  # of both executions
    distances = via_distances(path.x, via_points(task))[:, -2:]
    return [
        within(
            "without the force, largest distance of the motion from the reference's path [m]", float(away[0]), high=0.3
        ),
        within("with it, over that without", float(away[1] / away[0]), low=2.0),
        within(
            "distance to the last two via-points, with over without", (distances[1] / distances[0]).numpy(), low=2.0
        ),
    ]


def profile(setting: Setting) -> list[Check]:
    """Applied stiffness of each axis, in the half with the force and in the other, before learning and after it."""
    learner = half_plane(setting.runs, setting.seed)
    inside, outside = stiffness_by_half(final(learner))
    before = 10.0
    return [
        changes("s2 where the force can be [N/m]", before, inside[:, 1].numpy(), falls=False),
        changes("s2 elsewhere", before, outside[:, 1].numpy()),
        changes("s1 where the force can be", before, inside[:, 0].numpy()),
        changes("s1 elsewhere", before, outside[:, 0].numpy()),
    ]


@torch.no_grad()
def less_deviated(setting: Setting) -> list[Check]:
    """The reference's distances, and the gap between the two executions."""
    learner = half_plane(setting.runs, setting.seed)
    before, after = learner.task.rollout(learner.initial), final(learner)

    def distance(path: Rollout) -> Tensor:
        return via_distances(path.reference[..., 0, :, :], via_points(learner.task)).mean(-1)

    return [
        changes(
            "mean distance of the reference to the via-points [m]", float(distance(before)), distance(after).numpy()
        ),
        changes(
            "largest distance between the motions with and without the force [m]",
            float(pushed(before)),
            pushed(after).numpy(),
        ),
    ]


def two_phases(setting: Setting) -> list[Check]:
    """The stiffness cost at a tenth of the updates and at the end, and how soon the via-point cost falls."""
    learner = half_plane(setting.runs, setting.seed)
    cost, via = course(learner, "stiffness"), course(learner, "via_points")
    tenth = (len(cost) - 1) // 10
    return [
        changes("stiffness cost in the first tenth", cost[0], cost[tenth], falls=False),
        changes("stiffness cost afterwards", cost[tenth], cost[-1]),
        changes(
            "share of the fall of the via-point cost in the first quarter, against one half",
            0.5,
            early_share(via),
            falls=False,
        ),
    ]


def diagonal(setting: Setting) -> list[Check]:
    """Final costs with diagonal stiffness against those with isotropic stiffness."""
    ours, theirs = (course(half_plane(setting.runs, setting.seed, kind))[-1] for kind in ("diagonal", "isotropic"))
    return [lower("final cost, diagonal below isotropic", ours, theirs)]


CLAIMS = (
    Claim(
        "moving-target",
        "5.1",
        "With a stable system the motion still converges when the frame of the target moves.",
        f"Of learned stable policies, the target jumping by {MOVED:g} to {N_TARGETS} places half-way: all motions come nearer "
        "in every step, and arrive.",
        moving_target,
    ),
    Claim(
        "critical-damping",
        "5.2, Eq. 33",
        "A damping of 2 √(s m) keeps the controlled system critically damped.",
        "Eq. 33 as printed, of a mass without damping of its own, overshoots a step of the reference by less than 1 %, and "
        f"settles within 2 % of it at most {LATE} time steps of {DT} s after critical damping in closed form, 5.83 √(m/s), "
        "at all stiffnesses that the tasks allow.",
        damping,
    ),
    Claim(
        "divergent-before",
        "5.4, Fig. 9",
        "Before learning the reference lies beside the nominal path, and in spite of the high stiffness the field disturbs the "
        "motion.",
        "The reference is off by more than 0.1 m, and the point mass by a tenth more than that.",
        disturbed,
    ),
    Claim(
        "divergent-motions",
        "5.4, Fig. 10",
        "The stiffness decreases, and still most motions pass nearer to the via-points.",
        "Mean stiffness falls, and more than half of the runs come nearer.",
        softer_and_closer,
    ),
    Claim(
        "divergent-costs",
        "5.4, Fig. 11",
        "Both the stiffness cost and the via-point cost fall significantly.",
        "So they do.",
        falls_of_both,
    ),
    Claim(
        "divergent-together",
        "5.4",
        "The task needs the reference and the stiffness to be refined together.",
        "Learning both ends lower than learning either alone.",
        together,
    ),
    Claim(
        "half-plane-before",
        "5.4, Fig. 12",
        "Before learning the motion tracks its reference without the force, and with it is moved far from the last two "
        "via-points.",
        "Within 0.3 m without; with the force at least twice as far from the reference and from these via-points.",
        missed,
    ),
    Claim(
        "half-plane-motions",
        "5.4, Fig. 13",
        "The reference passes nearer to the via-points, and the disturbed motion is less deviated.",
        "Both distances fall.",
        less_deviated,
    ),
    Claim(
        "half-plane-stiffness",
        "5.4, Fig. 13",
        "Stiffness across the motion rises where the force can be and falls before; along the motion it falls everywhere.",
        "Mean applied stiffness of each axis in each half, from 10 N/m.",
        profile,
    ),
    Claim(
        "half-plane-phases",
        "5.4, Fig. 14a",
        "The via-point cost falls fast while the stiffness cost first rises, then that falls too.",
        "The stiffness cost is higher after a tenth of the updates, lower again at the end, and the first quarter brings half "
        "of the fall of the via-point cost.",
        two_phases,
    ),
    Claim(
        "diagonal-below-isotropic",
        "5.4, Fig. 14b",
        "A stiffness for each axis ends significantly lower than one for both.",
        "So it does.",
        diagonal,
    ),
)
