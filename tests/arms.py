"""Three arms as descriptions, from what their makers and others publish: a Franka Panda, a KUKA iiwa 14, a UR5.

Kinematics are the published Denavit-Hartenberg parameters, torque limits those of the data sheets. Masses are published too
(Panda: Gaz et al. 2019, rounded; UR5: Universal Robots), or ours (iiwa: 30 kg in all); each link is a ball in its middle.
"""

import sys
from math import cos, pi, sin
from pathlib import Path
from typing import NamedTuple

RADIUS = 0.06  # m


class Description(NamedTuple):
    """`frames`: of each joint in the one before, then of the tool: x, y, z [m] and the turn about x [rad]."""

    frames: list
    masses: tuple
    efforts: tuple
    limit: float
    goal: tuple  # joint angles from which a motion of some decimetres is possible all around
    text: str


def modified(a, d, alpha, flange):
    """Frames from parameters as in Craig's book."""
    rows = zip((*a, 0.0), (*d, flange), (*alpha, 0.0), strict=True)
    return [(x, -z * sin(turn), z * cos(turn), turn) for x, z, turn in rows]


def classic(a, d, alpha):
    """Frames from parameters as Denavit and Hartenberg wrote them."""
    return [(0.0, 0.0, 0.0, 0.0), *((x, 0.0, z, turn) for x, z, turn in zip(a, d, alpha, strict=True))]


def middle(frame):
    """Of a link, whose next joint has this frame."""
    return " ".join(str(0.5 * value) for value in frame[:3])


def urdf(frames, masses, efforts, limit):
    parts = ['<robot name="arm"><link name="base"/>']
    for i, (frame, mass) in enumerate(zip(frames, (*masses, 0.0), strict=True)):
        name, parent, last = f"link{i + 1}", f"link{i}" if i else "base", i == len(masses)
        origin = f'<origin xyz="{frame[0]} {frame[1]} {frame[2]}" rpy="{frame[3]} 0 0"/>'
        if last:
            joint = '<joint name="tool" type="fixed">'
            parts.append('<link name="tool"/>')
            name = "tool"
        else:
            ball = 0.4 * mass * RADIUS**2
            inertia = f'<inertia ixx="{ball}" iyy="{ball}" izz="{ball}" ixy="0" ixz="0" iyz="0"/>'
            parts.append(
                f'<link name="{name}"><visual><geometry><mesh filename="package://nowhere/{name}.dae"/></geometry></visual>'
                f'<inertial><origin xyz="{middle(frames[i + 1])}"/><mass value="{mass}"/>{inertia}</inertial></link>'
            )
            joint = f'<joint name="joint{i + 1}" type="revolute"><axis xyz="0 0 1"/>'
            joint += f'<limit lower="{-limit}" upper="{limit}" effort="{efforts[i]}" velocity="3"/>'
        parts.append(f'{joint}{origin}<parent link="{parent}"/><child link="{name}"/></joint>')
    return "".join([*parts, "</robot>"])


def mjcf(frames, masses, efforts, limit):
    """With motors, rotors, and two fingers that are no part of the arm."""
    text = (
        f'<site name="tool" pos="{frames[-1][0]} {frames[-1][1]} {frames[-1][2]}" euler="{frames[-1][3]} 0 0"/>'
        '<body name="left" pos="0 .03 .1"><joint type="slide" axis="0 1 0"/><geom size=".01" mass=".02"/></body>'
        '<body name="right" pos="0 -.03 .1"><joint type="slide" axis="0 1 0"/><geom size=".01" mass=".02"/></body>'
    )
    for i in reversed(range(len(masses))):
        x, y, z, turn = frames[i]
        ball = 0.4 * masses[i] * RADIUS**2
        text = (
            f'<body name="link{i + 1}" pos="{x} {y} {z}" euler="{turn} 0 0">'
            f'<inertial mass="{masses[i]}" pos="{middle(frames[i + 1])}" diaginertia="{ball} {ball} {ball}"/>'
            f'<joint name="joint{i + 1}" axis="0 0 1" range="{-limit} {limit}" armature="0.05"/>{text}</body>'
        )
    motors = "".join(
        f'<motor joint="joint{i + 1}" ctrlrange="{-effort} {effort}"/>' for i, effort in enumerate(efforts)
    )
    return (
        '<mujoco><compiler angle="radian"/><option><flag contact="disable"/></option>'
        f"<worldbody>{text}</worldbody><actuator>{motors}</actuator></mujoco>"
    )


def described(write, frames, masses, efforts, limit, goal):
    return Description(frames, masses, efforts, limit, goal, write(frames, masses, efforts, limit))


ARMS = {
    "panda": described(
        urdf,
        modified(
            (0, 0, 0, 0.0825, -0.0825, 0, 0.088),
            (0.333, 0, 0.316, 0, 0.384, 0, 0),
            (0, -pi / 2, pi / 2, pi / 2, -pi / 2, pi / 2, pi / 2),
            0.107,
        ),
        (4.97, 0.65, 3.23, 3.59, 1.23, 1.67, 0.74),
        (87, 87, 87, 87, 12, 12, 12),
        2.9,
        (0.1, 0.1, -0.1, -2.0, 0.1, 2.1, 0.8),
    ),
    "iiwa": described(
        mjcf,
        classic((0,) * 7, (0.36, 0, 0.42, 0, 0.4, 0, 0.126), (-pi / 2, pi / 2, pi / 2, -pi / 2, -pi / 2, pi / 2, 0)),
        (6.0, 6.0, 5.0, 5.0, 4.0, 3.0, 1.0),
        (320, 320, 176, 176, 110, 40, 40),
        2.9,
        (0.1, 0.6, 0.1, -1.4, 0.1, 1.0, 0.2),
    ),
    "ur5": described(
        urdf,
        classic(
            (0, -0.425, -0.39225, 0, 0, 0),
            (0.089159, 0, 0, 0.10915, 0.09465, 0.0823),
            (pi / 2, 0, 0, pi / 2, -pi / 2, 0),
        ),
        (3.7, 8.393, 2.275, 1.219, 1.219, 0.1879),
        (150, 150, 150, 28, 28, 28),
        6.2,
        (0.2, -1.4, 1.7, -1.9, -1.5, 0.3),
    ),
}


def write(folder):
    """Their files, `panda.urdf`, `iiwa.xml` and `ur5.urdf`, for `python -m train arm`: `python -m tests.arms FOLDER`."""
    for name, arm in ARMS.items():
        path = Path(folder) / f"{name}.{'urdf' if arm.text.startswith('<robot') else 'xml'}"
        path.write_text(arm.text)
        print(path, "--tool tool --posture", *arm.goal)


if __name__ == "__main__":
    write(sys.argv[1])
