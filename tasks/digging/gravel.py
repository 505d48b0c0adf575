"""Gravel: grains that move in the plane of the task, settled once in a box and kept in a cache.

Each grain is a ball in MuJoCo that slides along x and z and turns about y, with the mass of a disc as wide as the blade: a
planar discrete-element model in a scene in three dimensions, which a box of the same size full of free balls would cost
several times. The solver's settings were measured, and are at the edge: less than 15 Newton iterations, or conjugate
gradients in their place, let the bed explode. Grains are numbered by their place along x, since the factorisation of the
Hessian does not reorder them: by rows in place of columns the same bed takes six times as long.

A bed that nothing touches is put to sleep by MuJoCo, and costs a fifteenth, until the blade wakes all of it. Awake it creeps,
since MuJoCo's contacts are soft, at 0.4 to 0.6 mm/s. What it is not: round grains roll, so that its slopes are half as steep
as those of gravel (`tasks.digging.checks`).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from dataclasses import astuple, dataclass, replace
from math import pi
from pathlib import Path

import mujoco
import numpy as np
import torch

from torchds import files
from torchds.errors import FileError, InvalidArgumentError, TorchdsError

FORMAT = 2
"""Version of the beds in the cache; raise it with any change of the model of the bed."""

SOLREF, SOLIMP = (0.01, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
WALL_HEIGHT, WALL_THICKNESS = 0.20, 0.02  # m
AT_REST = 0.05  # m/s
GRAIN, RIGID = (1, 3), (2, 3)
"""(contype, conaffinity): grains touch everything, shovel and box the grains and each other."""


class SettlingError(TorchdsError, RuntimeError):
    """A bed did not come to rest, or lost grains."""


@dataclass(frozen=True)
class Gravel:
    """The settings of a bed.

    Attributes:
        n_grains: in the box.
        radius: smallest and largest, uniformly drawn [m].
        box: x of the walls [m].
        width: of the discs, that of the blade [m].
        density: of the grains' material [kg/m³].
        friction: between all bodies.
        seed: of the radii.
        packings: beds that are settled from different first places; a trial meets one of them.
        time_step: of settling and of roll-outs [s].
        seconds: that the grains settle, and once more as long where one still rolls [s].
        sleep: speed [m/s] below which a bed that nothing touches is not computed until something does; 0 for never.
    """

    n_grains: int = 285
    radius: tuple[float, float] = (0.0045, 0.0075)
    box: tuple[float, float] = (0.56, 0.95)
    width: float = 0.10
    density: float = 2200.0
    friction: float = 0.8
    seed: int = 0
    packings: int = 24
    time_step: float = 0.004
    seconds: float = 3.0
    sleep: float = 0.02

    def __post_init__(self) -> None:
        low, high = self.radius
        if min(self.n_grains, self.packings) < 1 or not 0 < low <= high or not self.box[1] - self.box[0] > 4 * high:
            raise InvalidArgumentError(
                f"a bed has to have grains, radii 0 < low ≤ high, a box wider than two of them and a packing, got "
                f"{self.n_grains} grains, radius={self.radius}, box={self.box}, packings={self.packings}"
            )
        positive = (self.width, self.density, self.time_step, self.seconds)
        if not min(positive) > 0 or not min(self.friction, self.sleep) >= 0:
            raise InvalidArgumentError(
                f"width, density, time_step and seconds have to be positive, friction and sleep not negative, got {self}"
            )

    def radii(self) -> np.ndarray:
        """Radii of the grains, `(G,)` [m]."""
        return np.random.default_rng(self.seed).uniform(*self.radius, self.n_grains)

    def masses(self) -> np.ndarray:
        """Masses of the grains, `(G,)` [kg]."""
        return self.density * pi * self.radii() ** 2 * self.width

    def key(self, packing: int) -> str:
        """What the cache calls a bed: settings, model and MuJoCo's version; how many packings there are does not matter."""
        text = repr(
            (FORMAT, mujoco.__version__, astuple(replace(self, packings=1)), packing, SOLREF, SOLIMP, WALL_HEIGHT)
        )
        return hashlib.sha256(text.encode()).hexdigest()[:16]


COARSE = Gravel(n_grains=86, radius=(0.009, 0.014))
"""A bed as deep, of grains twice as large: for tests."""


def options(spec: mujoco.MjSpec, gravel: Gravel) -> None:
    """Set the solver in `spec` to what the grains need."""
    spec.option.timestep = gravel.time_step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.iterations, spec.option.ls_iterations = 20, 50
    if gravel.sleep > 0:
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        spec.option.sleep_tolerance = gravel.sleep


def touch(geom: mujoco.MjsGeom, kind: tuple[int, int], gravel: Gravel) -> None:
    """Let `geom` touch others as a GRAIN does, or as something RIGID."""
    geom.contype, geom.conaffinity = kind
    geom.condim, geom.friction[0] = 3, gravel.friction
    geom.solref[:], geom.solimp[:] = SOLREF, SOLIMP


def add(spec: mujoco.MjSpec, gravel: Gravel) -> None:
    """Put floor, box and grains into `spec`, after all other bodies."""
    low, high = gravel.box
    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2, 2, 0.1])
    floor.rgba[:] = 0.75, 0.75, 0.72, 1
    touch(floor, RIGID, gravel)
    for name, x in (("near_wall", low - WALL_THICKNESS / 2), ("far_wall", high + WALL_THICKNESS / 2)):
        wall = spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[WALL_THICKNESS / 2, 0.75 * gravel.width, WALL_HEIGHT / 2],
            pos=[x, 0, WALL_HEIGHT / 2],
        )
        wall.rgba[:] = 0.55, 0.42, 0.28, 1
        touch(wall, RIGID, gravel)
    axes = (("x", "SLIDE", (1, 0, 0)), ("z", "SLIDE", (0, 0, 1)), ("turn", "HINGE", (0, 1, 0)))
    for i, (radius, mass) in enumerate(zip(gravel.radii(), gravel.masses(), strict=True)):
        grain = spec.worldbody.add_body(name=f"grain{i}")
        for name, kind, axis in axes:
            grain.add_joint(name=f"grain{i}_{name}", type=getattr(mujoco.mjtJoint, f"mjJNT_{kind}"), axis=axis)
        geom = grain.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], mass=mass)
        geom.rgba[:] = 0.45 + 0.1 * (i % 3), 0.42 + 0.1 * (i % 3), 0.38 + 0.08 * (i % 3), 1
        touch(geom, GRAIN, gravel)


def lost(places: np.ndarray, gravel: Gravel) -> np.ndarray:
    """`(...)` True where a grain at `places` `(..., G, 3)` has left the box, is far above it, or is not a number."""
    x, z = places[..., 0], places[..., 1]
    low, high = gravel.box
    kept = (x > low) & (x < high) & (z > 0) & (z < 1.0)
    return np.asarray(~kept.all(-1))


def beds(gravel: Gravel, seeds: list[int], std: float = 1e-4) -> np.ndarray:
    """`(N, G, 3)`: for each seed one of the packings, each grain moved by `std` [m]; a bed depends on its seed alone."""
    made = np.stack([bed(gravel, seed % gravel.packings) for seed in seeds])
    for places, seed in zip(made, seeds, strict=True):
        places[:, :2] += np.random.default_rng(seed).normal(0.0, std, (gravel.n_grains, 2))
    return made


def bed(gravel: Gravel, packing: int = 0) -> np.ndarray:
    """Places `(G, 3)` of the settled grains: x, z [m] and turn [rad]; computed once, then from the cache.

    What the cache holds is verified, and computed anew where it is damaged.

    Raises:
        SettlingError: the settings give no bed at rest.
    """
    key = gravel.key(packing)
    path = cache_folder() / f"gravel-{key}.pt"
    with contextlib.suppress(FileError):  # not there, damaged, or another bed under its name
        kept = files.load(path, "bed of gravel")
        if kept.get("key") == key:
            return kept["places"].numpy()
    places = settle(gravel, packing)
    with contextlib.suppress(FileError, OSError):  # where nothing can be written, it is not kept
        path.parent.mkdir(parents=True, exist_ok=True)
        files.save(path, "bed of gravel", {"key": key, "places": torch.from_numpy(places)})
    return places


def settle(gravel: Gravel, packing: int = 0) -> np.ndarray:
    """Drop the grains into the box and wait: places `(G, 3)`.

    Raises:
        SettlingError: see `bed`.
    """
    spec = mujoco.MjSpec()
    options(spec, replace(gravel, sleep=0.0))
    add(spec, gravel)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = _dropped(gravel, packing).ravel()
    steps = round(gravel.seconds / gravel.time_step)
    mujoco.mj_step(model, data, steps)
    waited = 0
    while (speed := np.abs(data.qvel.reshape(-1, 3)[:, :2]).max()) > AT_REST and waited < steps:
        mujoco.mj_step(model, data, max(1, steps // 20))  # a grain may roll on for a while
        waited += max(1, steps // 20)
    places = data.qpos.reshape(-1, 3).copy()
    if lost(places, gravel) or data.warning.number.any():
        raise SettlingError(
            f"the bed exploded or left the box; fewer grains or a smaller time step may settle: {gravel}"
        )
    if speed > AT_REST:
        raise SettlingError(f"a grain still moves at {speed:.3f} m/s; raise seconds={gravel.seconds}")
    return places


def cache_folder() -> Path:
    """The folder of settled beds: `torchds` in $XDG_CACHE_HOME, or in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "torchds"


def _dropped(gravel: Gravel, packing: int) -> np.ndarray:
    """First places `(G, 3)`, column by column from one wall to the other, not touching, in each column in any order."""
    generator = np.random.default_rng((gravel.seed, packing + 1))
    cell = 2.1 * gravel.radius[1]
    low, high = gravel.box
    n_columns = int((high - low) // cell)
    column = np.arange(gravel.n_grains) * n_columns // gravel.n_grains  # as many in each, but for one
    turn = np.lexsort((generator.uniform(size=gravel.n_grains), column))
    row = np.empty(gravel.n_grains)
    row[turn] = np.arange(gravel.n_grains) - np.searchsorted(column, column)
    jitter = generator.uniform(-0.04, 0.04, (gravel.n_grains, 2)) * gravel.radius[1]
    x = low + (column + 0.5) * (high - low) / n_columns + jitter[:, 0]
    z = (row + 0.6) * cell + jitter[:, 1]
    return np.stack([x, z, np.zeros_like(x)], -1)
