"""The KUKA LWR 4+ with gripper and shovel: one description, read by MuJoCo and by pytorch-kinematics.

All numbers stand here; `urdf` writes them down, and whatever needs the arm reads that text.

Sources:
    * Kinematics, joint limits, efforts, velocities: `kuka_lwr.urdf.xacro` of CentroEPiaggio/kuka-lwr (commit f9b638a) and
      of epfl-lasa/kuka-lwr-ros (2533aa1), which agree; kuka-isir/rtt_lwr (b832697) divides the links differently with the
      same sums 0.3105, 0.400, 0.390, 0.078 m.
    * Centres of mass and inertias of links 2 to 5: `lwr.urdf.xacro` of kuka-isir/rtt_lwr (b832697). Its inertias of links
      1, 6 and 7 are inflated on purpose there, so these are ours: link 1 as link 3, link 6 a ball of 6 cm radius, link 7 a
      disc of 4 cm radius and 3 cm thickness.
    * Mass of the base: CentroEPiaggio. Masses of the links: 2.7, 2.7, 2.7, 2.7, 1.7, 1.6, 0.3 kg; the public files disagree
      (2.0 to 2.7 kg for the large links) and we know no published identification of them link by link. Gravity is
      compensated with the same model, so they matter for little more than the inertia.
    * Armature (reflected rotors) and joint damping: ours, of the size usual for the gears of such arms.
    * Gripper and shovel: ours; a stub in place of the BarrettHand, with a round value for its mass.
"""

from __future__ import annotations

from math import pi, radians
from typing import NamedTuple

import mujoco
import numpy as np
import pytorch_kinematics
import torch
from torch import Tensor

from torchds.errors import InvalidArgumentError


class Link(NamedTuple):
    """One moving link and the joint that carries it.

    Attributes:
        offset: from the joint before, along its z [m].
        axis: of the joint.
        limit: of the joint angle, both ways [deg].
        effort: largest torque [N m].
        speed: largest joint speed [deg/s].
        armature: inertia of the rotor, reflected [kg m²].
        mass: [kg].
        centre: of mass, in the link's frame [m].
        inertia: about the axes of the link through the centre [kg m²].
    """

    offset: float
    axis: tuple[int, int, int]
    limit: float
    effort: float
    speed: float
    armature: float
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]


_LARGE, _FIFTH, _BALL, _DISC = (0.0142, 0.0141, 0.0042), (0.0088, 0.0081, 0.0036), (0.0023,) * 3, (14e-5, 14e-5, 24e-5)
LINKS = (
    Link(0.1100, (0, 0, 1), 170, 176, 110, 0.30, 2.7, (0, -0.0233, 0.118), _LARGE),
    Link(0.2005, (0, -1, 0), 120, 176, 110, 0.30, 2.7, (0, -0.0327, 0.0737), _LARGE),
    Link(0.2000, (0, 0, 1), 170, 100, 128, 0.20, 2.7, (0, -0.0233, 0.118), _LARGE),
    Link(0.2000, (0, 1, 0), 120, 100, 128, 0.20, 2.7, (0, 0.0327, 0.0737), _LARGE),
    Link(0.2000, (0, 0, 1), 170, 100, 204, 0.10, 1.7, (0, 0.0208, 0.0862), _FIFTH),
    Link(0.1900, (0, -1, 0), 120, 38, 184, 0.05, 1.6, (0, 0, 0), _BALL),
    Link(0.0780, (0, 0, 1), 170, 38, 184, 0.05, 0.3, (0, 0, -0.015), _DISC),
)
N_JOINTS = len(LINKS)
JOINTS = tuple(f"a{i + 1}" for i in range(N_JOINTS))
EFFORTS = tuple(link.effort for link in LINKS)
BASE_MASS = 2.0  # kg
JOINT_DAMPING = 0.5  # N m s/rad

GRIPPER_LENGTH, GRIPPER_RADIUS, GRIPPER_MASS = 0.10, 0.045, 1.2  # m, m, kg
SHOVEL_MASS = 0.6  # kg
TOOL_REACH = 0.26  # m from the flange to the tool point, the centre of the blade, along the flange's z
TOOL_ANGLE = radians(50)  # rad between the flange's z and the blade
BLADE_LENGTH, BLADE_WIDTH, BLADE_THICKNESS, WALL_HEIGHT, WALL_THICKNESS = 0.09, 0.10, 0.006, 0.020, 0.004  # m

SHOULDER_HEIGHT = LINKS[0].offset + LINKS[1].offset  # m
UPPER_ARM = LINKS[2].offset + LINKS[3].offset  # m
FOREARM = LINKS[4].offset + LINKS[5].offset  # m
HAND = LINKS[6].offset + TOOL_REACH  # m

_LENGTH = (0.2005, 0.2, 0.2, 0.2, 0.19, 0.078, 0.02)  # m, of the capsules that stand for the links
_RADIUS = (0.06, 0.06, 0.06, 0.06, 0.055, 0.05, 0.04)  # m


def urdf() -> str:
    """The arm with gripper and shovel as a URDF text.

    The base stands in the origin, z up. With joints 1, 3, 5 and 7 at zero the arm moves in the plane of x and z. The last
    link, `tool`, has its origin in the centre of the blade, x towards the tip and z up from the blade.
    """
    parts = ['<?xml version="1.0"?>', '<robot name="lwr">']
    parts.append(_link("base", BASE_MASS, (0, 0, 0.055), (0.005, 0.005, 0.005), [_cylinder(0.06, 0.11, (0, 0, 0.055))]))
    parent = "base"
    for i, link in enumerate(LINKS):
        name = f"link{i + 1}"
        shape = _cylinder(_RADIUS[i], _LENGTH[i], (0, 0, 0.5 * _LENGTH[i] if i < 6 else -0.01))
        parts.append(_link(name, link.mass, link.centre, link.inertia, [shape]))
        limit, speed = radians(link.limit), radians(link.speed)
        parts.append(
            f'<joint name="{JOINTS[i]}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
            f'<origin xyz="0 0 {link.offset}" rpy="0 0 0"/><axis xyz="{_row(link.axis)}"/>'
            f'<limit lower="{-limit!r}" upper="{limit!r}" effort="{link.effort}" velocity="{speed!r}"/>'
            f'<dynamics damping="{JOINT_DAMPING}" friction="0"/></joint>'
        )
        parent = name
    r, h = GRIPPER_RADIUS, GRIPPER_LENGTH
    across = GRIPPER_MASS * (3 * r * r + h * h) / 12
    inertia = (across, across, 0.5 * GRIPPER_MASS * r * r)
    parts.append(_link("gripper", GRIPPER_MASS, (0, 0, h / 2), inertia, [_cylinder(r, h, (0, 0, h / 2))]))
    parts.append(_fixed("gripper", "link7", (0, 0, 0), 0.0))
    # The shovel's frame is that of the blade, in the grip; there the force/torque sensor sits.
    reach = TOOL_REACH - GRIPPER_LENGTH
    tool = _vector(np.cos(TOOL_ANGLE), 0, -np.sin(TOOL_ANGLE)) * reach  # in the shovel's frame
    centre = tool + _vector(-0.02, 0, 0.01)
    parts.append(_link("shovel", SHOVEL_MASS, centre, (6e-4, 1.2e-3, 1.2e-3), _shovel_shapes(tool)))
    parts.append(_fixed("shovel", "gripper", (0, 0, GRIPPER_LENGTH), -TOOL_ANGLE - pi / 2))
    parts.append('<link name="tool"/>')
    parts.append(_fixed("tool", "shovel", tool, 0.0))
    return "\n".join([*parts, "</robot>"])


def chain(dtype: torch.dtype = torch.float64) -> pytorch_kinematics.SerialChain:
    """Base to tool in pytorch-kinematics, which rounds the offsets to float32 when it reads them (1e-8 m here)."""
    return pytorch_kinematics.build_serial_chain_from_urdf(urdf(), "tool").to(dtype=dtype)


def spec() -> mujoco.MjSpec:
    """The arm in MuJoCo: with rotors, one torque motor a joint, the sites `tool` and `ft` and the sensor in the latter.

    The sensors `force` [N] and `torque` [N m] are what the gripper feels of the shovel, in the frame of the site `ft`:
    at rest the shovel's weight, upwards.
    """
    arm = mujoco.MjSpec.from_string(urdf())
    arm.compiler.fusestatic = False  # the shovel stays a body of its own, for the sensor
    for name, link in zip(JOINTS, LINKS, strict=True):
        arm.joint(name).armature = link.armature
        motor = arm.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.ctrllimited, motor.ctrlrange = True, [-link.effort, link.effort]
    arm.body("tool").add_site(name="tool")
    arm.body("shovel").add_site(name="ft")
    for name, kind in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
        arm.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="ft")
    return arm


def posture(x: Tensor, z: Tensor, angle: Tensor) -> Tensor:
    """Joint angles `(..., 7)` [rad] that hold the tool in the plane of x and z, elbow up, joints 1, 3, 5, 7 at zero.

    Args:
        x: `(...)` of the tool point, forward [m].
        z: `(...)` of the tool point, up [m].
        angle: `(...)` pitch of the blade, tip up [rad].

    Raises:
        InvalidArgumentError: out of reach, or beyond the limits of a joint.
    """
    q, within = _elbow_up(x, z, angle)
    if not within.all():
        raise InvalidArgumentError(
            f"the tool does not reach x={x.tolist()}, z={z.tolist()} m at angle={angle.tolist()} rad with the elbow up"
        )
    return q


def reaches(x: Tensor, z: Tensor, angle: Tensor) -> Tensor:
    """`(...)` whether `posture` has an answer; False where a number is not finite."""
    return _elbow_up(x, z, angle)[1]


def _elbow_up(x: Tensor, z: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    x, z, angle = torch.broadcast_tensors(x, z, angle)
    hand = TOOL_ANGLE - angle  # of the flange's z, below the horizon
    u, w = x - HAND * hand.cos(), z + HAND * hand.sin() - SHOULDER_HEIGHT  # of the wrist, seen from the shoulder
    cosine = (u * u + w * w - UPPER_ARM**2 - FOREARM**2) / (2 * UPPER_ARM * FOREARM)
    a4 = cosine.clamp(-1, 1).acos()
    upper = torch.atan2(u, w) - torch.atan2(FOREARM * a4.sin(), UPPER_ARM + FOREARM * a4.cos())  # from the vertical
    a6 = upper + a4 - hand - pi / 2
    zero = torch.zeros_like(x)
    q = torch.stack([zero, -upper, zero, a4, zero, a6, zero], -1)
    limit = q.new_tensor([radians(link.limit) for link in LINKS])
    return q, (cosine.abs() <= 1) & (q.abs() <= limit).all(-1)


def _vector(x: float, y: float, z: float) -> np.ndarray:
    return np.array([x, y, z])


def _row(values: object) -> str:
    return " ".join(repr(float(v)) for v in np.asarray(values))


def _cylinder(radius: float, length: float, at: object) -> str:
    shape = f'<geometry><cylinder radius="{radius}" length="{length}"/></geometry>'
    return f'<collision><origin xyz="{_row(at)}" rpy="0 0 0"/>{shape}</collision>'


def _box(size: object, at: object, pitch: float = 0.0) -> str:
    shape = f'<geometry><box size="{_row(size)}"/></geometry>'
    return f'<collision><origin xyz="{_row(at)}" rpy="0 {pitch!r} 0"/>{shape}</collision>'


def _shovel_shapes(tool: np.ndarray) -> list[str]:
    """Handle, blade, a wall behind and one on either side; the upper face of the blade passes through the tool point."""
    rear = tool - _vector(BLADE_LENGTH / 2, 0, 0)
    side_y, wall_z = (BLADE_WIDTH - WALL_THICKNESS) / 2, WALL_HEIGHT / 2
    side = [BLADE_LENGTH, WALL_THICKNESS, WALL_HEIGHT]
    length, pitch = float(np.linalg.norm(rear)), float(np.arctan2(-rear[2], rear[0]))
    return [
        _box([BLADE_LENGTH, BLADE_WIDTH, BLADE_THICKNESS], tool - _vector(0, 0, BLADE_THICKNESS / 2)),
        _box([WALL_THICKNESS, BLADE_WIDTH, WALL_HEIGHT], rear + _vector(WALL_THICKNESS / 2, 0, wall_z)),
        _box(side, tool + _vector(0, side_y, wall_z)),
        _box(side, tool + _vector(0, -side_y, wall_z)),
        _box([length, 0.02, 0.016], rear / 2, pitch),
    ]


def _link(name: str, mass: float, centre: object, inertia: tuple[float, ...], shapes: list[str]) -> str:
    ixx, iyy, izz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{_row(centre)}" rpy="0 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>{"".join(shapes)}</link>'
    )


def _fixed(name: str, parent: str, at: object, pitch: float) -> str:
    return (
        f'<joint name="{name}_fixed" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{_row(at)}" rpy="0 {pitch!r} 0"/></joint>'
    )
