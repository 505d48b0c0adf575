"""Pictures of the world from the snapshots of a recording, without a screen."""

from __future__ import annotations

import mujoco
import numpy as np
from torch import Tensor

from tasks.digging.gravel import WALL_HEIGHT, WALL_THICKNESS, Gravel
from tasks.digging.worlds import build
from torchds.errors import TorchdsError

PEBBLES = 7
"""Shown for each grain, across the width of the blade: the grains of the plane stand for discs."""


class NoRendererError(TorchdsError, RuntimeError):
    """Nothing on this machine can render."""


def picture_model(gravel: Gravel) -> mujoco.MjModel:
    """The world with a row of pebbles in place of each grain, so that the plane looks like the box of gravel it stands for."""
    spec = build(gravel)
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER and not geom.parent.name.endswith("gripper"):
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE  # round joints
    low, high = gravel.box
    back = spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[(high - low) / 2 + WALL_THICKNESS, 0.005, WALL_HEIGHT / 2],
        pos=[(low + high) / 2, 0.75 * gravel.width, WALL_HEIGHT / 2],
        contype=0,
        conaffinity=0,
    )
    back.rgba[:] = 0.62, 0.48, 0.33, 1
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=64)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1[:], sky.rgb2[:] = (0.93, 0.95, 0.98), (0.72, 0.79, 0.88)
    generator = np.random.default_rng(gravel.seed + 2)
    for body in spec.bodies:
        if not body.name.startswith("grain"):
            continue
        (ball,) = body.geoms
        radius = ball.size[0]
        ball.rgba[3] = 0.0
        for y in np.linspace(-0.5, 0.5, PEBBLES) * (gravel.width - radius):
            pebble = body.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, contype=0, conaffinity=0, mass=0.0)
            pebble.size = radius * generator.uniform(0.75, 1.25, 3)
            pebble.pos = radius * generator.normal(scale=(0.35, 0.4, 0.35)) + np.array([0.0, y, 0.0])
            shade = generator.uniform(0.38, 0.62)
            pebble.rgba = [shade * 1.04, shade, shade * generator.uniform(0.85, 0.97), 1.0]
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 14, 10
    spec.visual.quality.shadowsize = 2048
    spec.visual.headlight.ambient[:], spec.visual.headlight.diffuse[:] = 0.45, 0.5
    return spec.compile()


def render(gravel: Gravel, snapshots: Tensor, size: tuple[int, int] = (640, 480)) -> np.ndarray:
    """Pictures `(F, height, width, 3)` in bytes of snapshots `(F, nq)`.

    Args:
        gravel: the bed.
        snapshots: generalised positions of arm and grains, as a `Recording` has them.
        size: width and height [pixels].

    Raises:
        NoRendererError: there is no OpenGL without a screen here; the message says what would help.
    """
    model = picture_model(gravel)
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0.45, 0.0, 0.30
    camera.distance, camera.azimuth, camera.elevation = 1.45, 108, -16
    model.vis.global_.offwidth, model.vis.global_.offheight = size
    try:
        renderer = mujoco.Renderer(model, height=size[1], width=size[0])
    except Exception as error:  # whatever the OpenGL library of this machine raises
        raise NoRendererError(
            f"no picture: OpenGL without a screen failed ({error}); install libegl1 or libosmesa6 and set MUJOCO_GL to egl "
            "or osmesa"
        ) from error
    pictures = []
    with renderer:
        for qpos in snapshots.numpy():
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            renderer.update_scene(data, camera)
            pictures.append(renderer.render())
    return np.stack(pictures)
