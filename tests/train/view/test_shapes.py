"""Shapes of a model: what is drawn, and that it moves as MuJoCo says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.arms import ARMS
from torchds.impedance import arm

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("trimesh")

from train.view.shapes import Shapes  # noqa: E402

SCENE = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
  <body><joint axis="0 1 0"/><geom type="box" size=".1 .2 .3" pos="1 0 0"/><geom size=".2" rgba="1 0 0 0"/></body>
  <body><joint type="slide" axis="0 0 1"/><geom type="ellipsoid" size=".1 .2 .3"/></body></worldbody></mujoco>"""


def test_planes_and_what_is_transparent_are_left_out_and_the_rest_moves():
    shapes = Shapes(mujoco.MjModel.from_xml_string(SCENE))
    assert len(shapes.solids) == 1 and shapes.sizes.tolist() == [[0.1, 0.2, 0.3]]
    box, ball = shapes.at(np.array([np.pi / 2, 0.7]))
    np.testing.assert_allclose(box.x, [[0.0, 0.0, -1.0]], atol=1e-12)  # a quarter of a turn about y
    np.testing.assert_allclose(np.abs(box.wxyz), [[np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]], atol=1e-12)
    np.testing.assert_allclose(ball.x, [[0.0, 0.0, 0.7]])


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_without_shapes_is_a_skeleton_whose_bones_end_at_its_bodies(name):
    model = arm(ARMS[name].text, "tool").model
    shapes, data = Shapes(model), mujoco.MjData(model)
    data.qpos[:] = np.linspace(0.2, 0.6, model.nq)
    mujoco.mj_kinematics(model, data)
    bones, joints = shapes.at(data.qpos)
    fingers = {"left", "right"} & {model.body(i).name for i in range(model.nbody)}  # balls, which come first
    np.testing.assert_allclose(joints.x[: len(fingers)], data.geom_xpos)
    links = [i for i in range(1, model.nbody) if model.body(i).name not in fingers]
    ends = [(data.xpos[model.body_parentid[i]], data.xpos[i]) for i in links]
    bones_there = [(a + b) / 2 for a, b in ends if np.linalg.norm(a - b) > 1e-3]
    np.testing.assert_allclose(bones.x, bones_there)
    assert len(bones.x) >= 3 and len(shapes.solids) == len(bones.x) and len(shapes.sizes) == len(joints.x)
    near = np.linalg.norm(data.xpos[:, None] - joints.x, axis=-1).min(1)
    assert near[[0, *links]].max() < 1e-9  # each of these bodies has a ball


MESH = """<mujoco><asset><mesh name="wedge" vertex="0 0 0  .3 0 0  0 .2 0  0 0 .1"/></asset><worldbody>
  <geom type="plane" size="1 1 .1"/>
  <body pos="0 0 .5"><joint axis="0 1 0"/><geom type="mesh" mesh="wedge"/><geom type="box" size="1 1 1" group="3"/>
  <body pos="0 0 .4"><joint axis="0 1 0"/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/></body></body>
</worldbody></mujoco>"""


def test_a_mesh_is_where_its_vertices_say_and_what_the_viewer_hides_is_not_there():
    shapes = Shapes(mujoco.MjModel.from_xml_string(MESH))
    ((vertices, faces, _),) = shapes.solids
    solid, _ = shapes.at(np.array([np.pi / 2, 0.0]))
    turn = Rotation.from_quat(np.roll(solid.wxyz[0], -1))  # (w, x, y, z) there
    corners = turn.apply(vertices) + solid.x[0]
    expected = [[0, 0, 0.5], [0, 0, 0.2], [0, 0.2, 0.5], [0.1, 0, 0.5]]  # x becomes -z, and z becomes x
    np.testing.assert_allclose(corners, expected, atol=1e-6)
    assert faces.shape == (4, 3)
