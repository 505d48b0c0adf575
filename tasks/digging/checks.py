"""What the bed is like beside real gravel, and beside a bed that costs more: `python -m tasks.digging.checks`.

Published values: angle of repose of gravel 30 to 45° (natural to crushed; Al-Hashemi & Al-Amoudi, Powder Technology 330, 2018,
table 2). Resistance to a blade pushed in on edge: bearing capacity of a deep strip, q = γ z N_q with
N_q = exp(π tan φ) tan²(45° + φ/2) (Prandtl, Reissner; in any textbook of soil mechanics), for that range of φ.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from math import exp, pi, radians, tan

import mujoco
import numpy as np
import torch

from tasks.digging import gravel as beds
from tasks.digging import lwr
from tasks.digging.gravel import Gravel
from tasks.digging.simulation import dig
from tasks.digging.task import LwrDigging
from tasks.digging.worlds import GRAVITY, Worlds

REPOSE = (30.0, 45.0)  # deg
STEEP = 38.0  # deg, to which the bed is tilted
TILTING, AFTER = 3.0, 5.0  # s
DEPTHS, PUSH = (0.02, 0.03, 0.04), 0.02  # m below the surface, m/s
STIFFNESSES = (150.0, 300.0, 450.0)  # N/m


def repose(gravel: Gravel, packing: int = 0) -> float:
    """Slope [deg] of a bed that was tilted until it slid, 5 s later."""
    model = _bed(gravel).compile()
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)  # a bed asleep does not feel how gravity turns
    data = mujoco.MjData(model)
    data.qpos[:] = beds.bed(gravel, packing).ravel()
    for part in np.linspace(0.0, 1.0, round(TILTING / gravel.time_step)):
        angle = radians(STEEP * part)
        model.opt.gravity[:] = GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        mujoco.mj_step(model, data)
    if gravel.sleep > 0:
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    mujoco.mj_step(model, data, round(AFTER / gravel.time_step))
    x, top = _surface(gravel, data.qpos.reshape(-1, 3))
    x, top = x[top > 0.02], top[top > 0.02]
    return float(STEEP - np.degrees(np.arctan(np.polyfit(x, top, 1)[0])))


def penetration(gravel: Gravel, packing: int = 0) -> list[float]:
    """Force [N] on a plate as thick and wide as the blade, pushed into the bed on edge, mean over 1 cm at each of DEPTHS."""
    spec = _bed(replace(gravel, sleep=0.0))
    plate = spec.worldbody.add_body(name="plate", mocap=True)
    half = [lwr.BLADE_THICKNESS / 2, lwr.BLADE_WIDTH / 2, lwr.BLADE_LENGTH / 2]
    beds.touch(plate.add_geom(name="plate", type=mujoco.mjtGeom.mjGEOM_BOX, size=half), beds.RIGID, gravel)
    model = spec.compile()
    data = mujoco.MjData(model)
    places = beds.bed(gravel, packing)
    data.qpos[:] = places.ravel()
    middle = np.mean(gravel.box)
    x, top = _surface(gravel, places)
    surface = float(np.interp(middle, x, top))
    depths, forces = [], []
    for depth in np.arange(-0.005, DEPTHS[-1] + 0.005, PUSH * gravel.time_step):
        data.mocap_pos[0] = middle, 0.0, surface - depth + half[2]
        mujoco.mj_step(model, data)
        depths.append(depth)
        forces.append(_pushed(model, data, model.geom("plate").id))
    around = [np.abs(np.array(depths) - depth) < 0.005 for depth in DEPTHS]
    return [float(np.mean(np.array(forces)[near])) for near in around]


def published(gravel: Gravel, angle: float, depth: float) -> float:
    """Bearing capacity [N] of the blade's edge at a depth [m], for gravel of a friction angle [deg]."""
    phi, packed = radians(angle), 0.83  # share of the plane that discs fill
    factor = exp(pi * tan(phi)) * tan(pi / 4 + phi / 2) ** 2
    return packed * gravel.density * GRAVITY * depth * factor * lwr.BLADE_THICKNESS * lwr.BLADE_WIDTH


def trials(gravel: Gravel, seeds: list[int]) -> tuple[dict[str, np.ndarray], float]:
    """Load, force cost and total `(seeds, STIFFNESSES)` of the imitated motion, and the processor time of a roll-out [s]."""
    task = LwrDigging()
    task.gravel = gravel
    path, reference, _ = task.reference(task.policy())
    worlds, s = Worlds(gravel, len(STIFFNESSES)), torch.tensor(STIFFNESSES, dtype=torch.float64)
    rows, spent = [], 0.0
    for seed in seeds:
        began = time.process_time()
        done = dig(worlds, reference, s, [seed] * len(s))
        spent += time.process_time() - began
        terms = task.cost_terms(replace(path, x=done.pose, v=done.pose.diff(dim=-2) / task.dt, plant=done))
        rows.append([done.load, terms["force"], torch.stack(list(terms.values())).sum(0)])
    table = torch.stack([torch.stack(row) for row in rows], 1).numpy()
    return dict(zip(("load", "force", "total"), table, strict=True)), spent / len(seeds) / len(s)


def _bed(gravel: Gravel) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    beds.options(spec, gravel)
    beds.add(spec, gravel)
    return spec


def _surface(gravel: Gravel, places: np.ndarray, width: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Middles of columns [m] and the height [m] up to which each is filled, but for those at the walls."""
    low, high = gravel.box
    edges = np.arange(low + width, high - width, width)
    top = places[:, 1] + gravel.radii()
    return edges + width / 2, np.array(
        [top[(places[:, 0] >= e) & (places[:, 0] < e + width)].max(initial=0.0) for e in edges]
    )


def _pushed(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """What a body that does not move feels from above to below [N]."""
    total, wrench = 0.0, np.zeros(6)
    for i in np.flatnonzero((data.contact.geom == geom).any(-1)):
        mujoco.mj_contactForce(model, data, i, wrench)
        along = data.contact.frame[i].reshape(3, 3).T @ wrench[:3]
        total += along[2] if data.contact.geom[i, 0] != geom else -along[2]
    return total


def _compare(whole: Gravel, gravel: Gravel, n: int) -> None:
    """Print medians over `n` trials in both beds, in turns, and the p-value of a two-sided Mann-Whitney test."""
    import scipy.stats

    pairs = []
    for seed in range(n):
        pairs.append([trials(bed, [seed]) for bed in (whole, gravel)])
        spent = [round(float(np.mean([pair[i][1] for pair in pairs])), 2) for i in (0, 1)]
        print(f"{seed + 1} of {n}: processor time of a roll-out {spent[0]} and {spent[1]} s", flush=True)
    for name in ("load", "force", "total"):
        before, after = (np.concatenate([pair[i][0][name] for pair in pairs]) for i in (0, 1))
        for s, a, b in zip(STIFFNESSES, before.T, after.T, strict=True):
            p = scipy.stats.mannwhitneyu(a, b).pvalue
            print(f"| {name}, {s:g} N/m | {np.median(a):.3g} | {np.median(b):.3g} | {p:.2f} |")


def _time() -> None:
    """Print what eight roll-outs on two threads take, the second time, and what of it the controller."""
    task = LwrDigging(initial_stiffness=300.0, threads=2)
    policy = task.policy().expand(8)
    task.rollout(policy)
    before, wall, processor = task.wall_seconds, time.perf_counter(), time.process_time()
    task.rollout(policy)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    control = task.wall_seconds["control"] - before["control"]
    print(
        f"8 roll-outs on two threads: {wall:.1f} s, of it {control / wall:.0%} control; {processor:.1f} s of processors"
    )


def _spread(values: list[float] | np.ndarray) -> str:
    return f"{np.mean(values):.1f} ± {np.std(values, ddof=1):.1f}"


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--same", type=int, default=0, metavar="N", help="compare N trials with the bed as it was")
    parser.add_argument("--time", action="store_true", help="time eight roll-outs on two threads")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    gravel = Gravel()
    whole = replace(gravel, n_grains=366, box=(0.50, 1.00), sleep=0.0)  # a wider box, always awake
    if asked.same:
        return _compare(whole, gravel, asked.same)
    if asked.time:
        return _time()
    for what, sleep in (("angle of repose [°]", gravel.sleep), ("the same, never asleep", 0.0)):
        slopes = [repose(replace(gravel, sleep=sleep), k) for k in range(5)]
        print(f"| {what} | {_spread(slopes)} | {REPOSE[0]:g} to {REPOSE[1]:g} |")
    for depth, force in zip(DEPTHS, np.transpose([penetration(gravel, k) for k in range(10)]), strict=True):
        low, high = (published(gravel, angle, depth) for angle in REPOSE)
        print(f"| edge of the blade at {100 * depth:g} cm [N] | {_spread(force)} | {low:.0f} to {high:.0f} |")


if __name__ == "__main__":
    main()
