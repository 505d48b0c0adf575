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
MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
SHOWN = 3  # groups of geoms from here on are hidden in MuJoCo's viewer until they are asked for
BONE, JOINT = 0.02, 0.03  # m, radii of what stands for an arm without shapes
ORANGE, GREY = (0.95, 0.45, 0.1), (0.35, 0.37, 0.40)


class Pose(NamedTuple):
    """Places `(S, 3)` [m] and quaternions `(S, 4)`, scalar first, of shapes."""

    x: np.ndarray
    wxyz: np.ndarray


class Shapes:
    """The shapes of a model, and where they are.

    Geoms that are transparent or infinite, or in a group that MuJoCo's viewer hides, are left out. Bodies without any are drawn
    as a skeleton: a bone between each two that follow each other, a ball at its ends.

    Args:
        model: of MuJoCo.

    Attributes:
        solids: vertices, faces and colour of each shape that is not round.
        sizes, colours: `(B, 3)` of the round ones.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        seen = [i for i in range(model.ngeom) if model.geom_rgba[i, 3] > 0 and model.geom_group[i] < SHOWN]
        self._solid = np.array([i for i in seen if int(model.geom_type[i]) in (*MADE, MESH)], dtype=int)
        self._round = np.array([i for i in seen if int(model.geom_type[i]) in ROUND], dtype=int)
        self.solids = [(*self._mesh(i), tuple(model.geom_rgba[i, :3])) for i in self._solid]
        size = model.geom_size[self._round]
        ball = model.geom_type[self._round] == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        self.sizes = np.where(ball[:, None], size[:, :1], size)
        self.colours = model.geom_rgba[self._round, :3]
        bare = set(range(model.nbody)) - {int(model.geom_bodyid[i]) for i in (*self._solid, *self._round)}
        self._skeleton(bare | {0})

    def at(self, qpos: np.ndarray) -> tuple[Pose, Pose]:
        """Where the solid and the round shapes are at generalised positions `(nq,)`."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        (bones, joints), solid, round_ = self._bones_at(), self._of(self._solid), self._of(self._round)
        return _together(solid, bones), _together(round_, joints)

    def _mesh(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of a shape that is not round, where it is drawn from."""
        model, kind = self._model, int(self._model.geom_type[geom])
        if kind != MESH:
            made = MADE[kind](model.geom_size[geom])
            return made.vertices, made.faces
        mesh = model.mesh(model.geom_dataid[geom])
        vertices, faces = (
            slice(begin[0], begin[0] + n[0])
            for begin, n in ((mesh.vertadr, mesh.vertnum), (mesh.faceadr, mesh.facenum))
        )
        return model.mesh_vert[vertices], model.mesh_face[faces]

    def _of(self, geoms: np.ndarray) -> Pose:
        rotations = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        return Pose(self._data.geom_xpos[geoms].copy(), _quaternions(rotations))

    def _skeleton(self, bare: set[int]) -> None:
        """The bones between bodies that have no shape."""
        mujoco.mj_kinematics(self._model, self._data)
        parents = [(int(self._model.body_parentid[i]), i) for i in range(1, self._model.nbody)]
        lengths = {(a, b): float(np.linalg.norm(self._data.xpos[a] - self._data.xpos[b])) for a, b in parents}
        self._bones = [ends for ends, length in lengths.items() if bare.issuperset(ends) and length > 1e-3]
        for ends in self._bones:
            mesh = trimesh.creation.cylinder(BONE, lengths[ends])  # bodies are rigid
            self.solids.append((mesh.vertices, mesh.faces, ORANGE))
        self._joints = sorted({end for ends in self._bones for end in ends})
        self.sizes = np.concatenate([self.sizes, np.full((len(self._joints), 3), JOINT)])
        self.colours = np.concatenate([self.colours, np.tile(GREY, (len(self._joints), 1))])

    def _bones_at(self) -> tuple[Pose, Pose]:
        ends = self._data.xpos[np.array(self._bones, dtype=int).reshape(-1, 2)]  # (bones, 2, 3)
        turns = [trimesh.geometry.align_vectors([0, 0, 1], end - begin)[:3, :3] for begin, end in ends]
        still = np.tile([1.0, 0, 0, 0], (len(self._joints), 1))
        bones = Pose(ends.mean(1), _quaternions(np.array(turns).reshape(-1, 3, 3)))
        return bones, Pose(self._data.xpos[self._joints], still)


def ball() -> Any:
    """A ball of radius 1, of few triangles."""
    return trimesh.creation.icosphere(1)


def _together(*poses: Pose) -> Pose:
    return Pose(*(np.concatenate(parts) for parts in zip(*poses, strict=True)))


def _quaternions(rotations: np.ndarray) -> np.ndarray:
    if not len(rotations):
        return np.empty((0, 4))
    return scipy.spatial.transform.Rotation.from_matrix(rotations).as_quat()[:, [3, 0, 1, 2]]
