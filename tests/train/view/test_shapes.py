"""Shapes of a model: what is drawn, and that it moves as MuJoCo says."""

import numpy as np
import pytest

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
    if not shapes._bones:
        return  # it has shapes
    np.testing.assert_allclose(joints.x, data.xpos)
    for (parent, child), middle in zip(shapes._bones, bones.x, strict=True):
        np.testing.assert_allclose(2 * middle, data.xpos[parent] + data.xpos[child])
