"""What stands in a MuJoCo model as meshes that move: each shape once, balls and pebbles all in one batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.spatial.transform

from torchds.errors import MissingPackageError

try:
    import mujoco
except ImportError as error:
    raise MissingPackageError("mujoco", "digging", "a page with a scene") from error
try:
    import trimesh  # viser brings it
except ImportError as error:
    raise MissingPackageError("trimesh", "view", "a page with a scene") from error

ROUND = (int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID))
MADE = {
    int(mujoco.mjtGeom.mjGEOM_BOX): lambda size: trimesh.creation.box(2 * size),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): lambda size: trimesh.creation.cylinder(size[0], 2 * size[1]),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): lambda size: trimesh.creation.capsule(2 * size[1], size[0]),
}
BONE, JOINT = 0.02, 0.03  # m, radii of what stands for an arm without shapes
ORANGE, GREY = (0.95, 0.45, 0.1), (0.35, 0.37, 0.40)


class Pose(NamedTuple):
    """Places `(S, 3)` [m] and quaternions `(S, 4)`, scalar first, of shapes."""

    x: np.ndarray
    wxyz: np.ndarray


class Shapes:
    """The shapes of a model, and where they are.

    Geoms that are transparent or infinite are left out. A model without any is drawn as the skeleton of its bodies.

    Args:
        model: of MuJoCo.

    Attributes:
        solids: vertices, faces and colour of each shape that is not round.
        sizes, colours: `(B, 3)` of the round ones.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        seen = [i for i in range(model.ngeom) if model.geom_rgba[i, 3] > 0]
        self._solid = np.array([i for i in seen if int(model.geom_type[i]) in MADE], dtype=int)
        self._round = np.array([i for i in seen if int(model.geom_type[i]) in ROUND], dtype=int)
        self.solids: list[tuple[np.ndarray, np.ndarray, tuple[float, ...]]] = []
        for i in self._solid:
            mesh = MADE[int(model.geom_type[i])](model.geom_size[i])
            self.solids.append((mesh.vertices, mesh.faces, tuple(model.geom_rgba[i, :3])))
        size = model.geom_size[self._round]
        ball = model.geom_type[self._round] == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        self.sizes = np.where(ball[:, None], size[:, :1], size)
        self.colours = model.geom_rgba[self._round, :3]
        self._bones: list[tuple[int, int]] = []
        if not seen:
            self._skeleton()

    def at(self, qpos: np.ndarray) -> tuple[Pose, Pose]:
        """Where the solid and the round shapes are at generalised positions `(nq,)`."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        if self._bones:
            return self._bones_at()
        return self._of(self._solid), self._of(self._round)

    def _of(self, geoms: np.ndarray) -> Pose:
        rotations = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        return Pose(self._data.geom_xpos[geoms].copy(), _quaternions(rotations))

    def _skeleton(self) -> None:
        model = self._model
        mujoco.mj_kinematics(model, self._data)
        parents = [(int(model.body_parentid[i]), i) for i in range(1, model.nbody)]
        self._bones = [(a, b) for a, b in parents if np.linalg.norm(self._data.xpos[a] - self._data.xpos[b]) > 1e-3]
        for a, b in self._bones:
            length = float(np.linalg.norm(self._data.xpos[a] - self._data.xpos[b]))  # bodies are rigid
            mesh = trimesh.creation.cylinder(BONE, length)
            self.solids.append((mesh.vertices, mesh.faces, ORANGE))
        self.sizes = np.full((model.nbody, 3), JOINT)
        self.colours = np.tile(GREY, (model.nbody, 1))

    def _bones_at(self) -> tuple[Pose, Pose]:
        ends = self._data.xpos[np.array(self._bones)]  # (bones, 2, 3)
        along = ends[:, 1] - ends[:, 0]
        turns = np.stack([trimesh.geometry.align_vectors([0, 0, 1], each)[:3, :3] for each in along])
        still = np.tile([1.0, 0, 0, 0], (len(self._data.xpos), 1))
        return Pose(ends.mean(1), _quaternions(turns)), Pose(self._data.xpos.copy(), still)


def ball() -> Any:
    """A ball of radius 1, of few triangles."""
    return trimesh.creation.icosphere(1)


def _quaternions(rotations: np.ndarray) -> np.ndarray:
    if not len(rotations):
        return np.empty((0, 4))
    return scipy.spatial.transform.Rotation.from_matrix(rotations).as_quat()[:, [3, 0, 1, 2]]
