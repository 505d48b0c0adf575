"""The world: the arm with its shovel over a box of gravel, many copies of it stepped in parallel threads."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from torch import Tensor

from tasks.digging import gravel as beds
from tasks.digging import lwr
from tasks.digging.gravel import COARSE as COARSE
from tasks.digging.gravel import Gravel
from torchds.errors import InvalidArgumentError

GRAVITY = 9.81  # m/s²
PREFIX = "lwr/"


def build(gravel: Gravel) -> mujoco.MjSpec:
    """The arm, then the box and its grains; the arm's base is the origin."""
    world = mujoco.MjSpec()
    beds.options(world, gravel)
    arm = lwr.spec()
    for geom in arm.geoms:
        if geom.parent.name == "shovel":
            beds.touch(geom, beds.RIGID, gravel)
            geom.rgba[:] = 0.35, 0.37, 0.40, 1
        else:
            geom.contype = geom.conaffinity = 0  # the arm itself touches nothing
            geom.rgba[:] = (0.2, 0.2, 0.2, 1) if geom.parent.name in ("base", "gripper") else (0.95, 0.45, 0.1, 1)
    world.attach(arm, prefix=PREFIX, frame=world.worldbody.add_frame())
    world.worldbody.add_light(pos=[0.4, -1.5, 2.0], dir=[0.2, 0.6, -0.8])
    beds.add(world, gravel)
    return world


class Worlds:
    """N copies of the world, each with a bed of its own, advanced together.

    Args:
        gravel: the bed.
        n: N, roll-outs.
        n_threads: that share them; the results are the same, bit for bit, for any number.

    Attributes:
        seconds: wall time spent so far, "control" on kinematics, impedance law and bookkeeping, "physics" on MuJoCo [s].

    Raises:
        InvalidArgumentError: no roll-outs or threads.
    """

    def __init__(self, gravel: Gravel, n: int, n_threads: int = 1) -> None:
        if n < 1 or n_threads < 1:
            raise InvalidArgumentError(f"n and n_threads have to be at least 1, got {n} and {n_threads}")
        self.gravel = gravel
        self.n = n
        self.seconds = {"control": 0.0, "physics": 0.0}
        self.model = build(gravel).compile()
        self.batch = Batch(self.model, n, n_threads, persistent=True)  # sleep needs it
        batch, J = self.batch, lwr.N_JOINTS
        self._qpos, self._qvel, self._ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self._mass, self._bias, self._sensors = batch.bind("M"), batch.bind("qfrc_bias"), batch.bind("sensordata")
        self._frames = batch.bind("site_xmat")
        self._broken = np.zeros(n, dtype=bool)
        self._ft = self.model.site(PREFIX + "ft").id
        # The mass matrix is sparse; the arm comes first and is one chain, so its rows are full up to the diagonal.
        self._index = np.zeros((J, J), dtype=int)
        for i in range(J):
            start, columns = self.model.M_rowadr[i], self.model.M_rownnz[i]
            for k, j in enumerate(self.model.M_colind[start : start + columns]):
                self._index[i, j] = self._index[j, i] = start + k

    # ------------------------------------------------------------------ time

    def reset(self, q: Tensor, seeds: list[int]) -> None:
        """Put all arms at `q` `(N, J)` or `(J,)` [rad], at rest, over the beds of `seeds`.

        Raises:
            InvalidArgumentError: not one seed a roll-out.
        """
        if len(seeds) != self.n:
            raise InvalidArgumentError(f"seeds have to be {self.n}, one for each roll-out, got {len(seeds)}")
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.batch.warning[:] = 0
        self._broken[:] = False
        self._qpos[:, : lwr.N_JOINTS] = q.numpy()
        self._qpos[:, lwr.N_JOINTS :] = beds.beds(self.gravel, seeds).reshape(self.n, -1)
        self.batch.forward()

    def step(self, torque: Tensor) -> None:
        """Advance by one time step under `torque` `(N, J)` [N m]."""
        self._ctrl[:] = torque.numpy()
        try:
            self.batch.step()
        except SimulationError as error:  # the others were advanced
            self._broken[error.ids] = True

    # ------------------------------------------------------------------ what there is to see

    @property
    def q(self) -> Tensor:
        """`(N, J)` joint angles [rad]."""
        return torch.from_numpy(self._qpos[:, : lwr.N_JOINTS].copy())

    @property
    def v(self) -> Tensor:
        """`(N, J)` joint velocities [rad/s]."""
        return torch.from_numpy(self._qvel[:, : lwr.N_JOINTS].copy())

    @property
    def mass(self) -> Tensor:
        """`(N, J, J)` mass matrix of the arm [kg m²]; as all that follows, of one time step ago."""
        return torch.from_numpy(self._mass[:, self._index])

    @property
    def bias(self) -> Tensor:
        """`(N, J)` torque of gravity, centrifugal and Coriolis forces on the arm [N m]."""
        return torch.from_numpy(self._bias[:, : lwr.N_JOINTS].copy())

    @property
    def reading(self) -> tuple[np.ndarray, np.ndarray]:
        """What the force sensor reads: its frame `(N, 9)` in the base frame, and the force in it `(N, 3)` [N]; see `force`."""
        return self._frames[:, self._ft].copy(), self._sensors[:, :3].copy()

    @staticmethod
    def force(frame: np.ndarray, sensed: np.ndarray) -> Tensor:
        """`(..., 3)` with which the gripper holds the shovel, in the base frame [N]; at rest its weight and load, upwards.

        Args:
            frame: `(..., 9)` of one reading or many.
            sensed: `(..., 3)` beside it [N].
        """
        return torch.from_numpy(np.einsum("...ij,...j->...i", frame.reshape(*frame.shape[:-1], 3, 3), sensed))

    @property
    def grains(self) -> Tensor:
        """`(N, G, 3)` places of the grains: x, z [m], turn [rad]."""
        return torch.from_numpy(self._qpos[:, lwr.N_JOINTS :].reshape(self.n, -1, 3).copy())

    def snapshot(self) -> Tensor:
        """`(N, nq)` generalised positions of arm and grains now, in single precision."""
        return torch.from_numpy(self._qpos.astype(np.float32))

    @property
    def kinetic_energy(self) -> Tensor:
        """Kinetic energy of the grains, `(N,)` of their motion along x and z [J]."""
        speeds = self._qvel[:, lwr.N_JOINTS :].reshape(self.n, -1, 3)[..., :2]
        return torch.from_numpy(0.5 * (self.gravel.masses() * np.square(speeds).sum(-1)).sum(-1))

    @property
    def failed(self) -> Tensor:
        """`(N,)` True where MuJoCo warned or raised since the reset, or numbers are not finite or a grain is lost now."""
        grains = self._qpos[:, lwr.N_JOINTS :].reshape(self.n, -1, 3)
        broken = self._broken | ~np.isfinite(self._qpos).all(-1) | ~np.isfinite(self._qvel).all(-1)
        return torch.from_numpy(broken | beds.lost(grains, self.gravel) | (self.batch.warning != 0).any((-2, -1)))
