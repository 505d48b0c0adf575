"""How well an arm follows a learned motion of poses: `python -m train arm DESCRIPTION --posture ...`."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
import tyro
from torch import Tensor

from torchds import Demonstrations, GMRPolicy, rollout
from torchds.arm_law import rotation_vector
from torchds.errors import InvalidArgumentError
from torchds.impedance import PoseReference, arm
from train.tables import markdown

if TYPE_CHECKING:
    from torchds.impedance import Arm as Description

START = torch.tensor([-0.12, -0.2, 0.1, 0.4, -0.5, 0.6], dtype=torch.float64)
"""Where the motion begins, from its goal: 0.25 m away and turned by 50 degrees, [m] and [rad]."""
DT = 0.001
SEEN = 20  # time steps between two pictures
AROUND = ((1.1, -1.2, 0.9), (0.25, 0.0, 0.35))  # m, where the camera stands, and what it looks at
HEADER = ("arm", "farthest behind [mm]", "[°]", "from the goal at the end [mm]", "[°]", "torques cut", "a call [µs]")


@dataclass
class Arm:
    """Let an arm follow a learned motion of poses in MuJoCo under Cartesian impedance control, and say how well it does."""

    description: tyro.conf.Positional[Path]
    """URDF or MJCF."""
    posture: tuple[float, ...]
    """Joint angles at the goal of the motion, which begins 0.25 m and 50 degrees away [rad]."""
    tool: str = ""
    """Link, body or site at the end; the only end by default."""
    stiffness: float = 2000.0
    """Of the impedance [N/m]."""
    rotation_scale: float = 0.02
    """Stiffness of the rotation in the unit of the other [m²/rad]."""
    seconds: float = 3.0
    """Of the trial; the motion takes about two."""
    browser: tyro.conf.UseCounterAction[int] = 0
    """Show arm and motion in a web page afterwards, until it is interrupted (extra "view")."""
    port: int = 8080
    """Of the page."""

    def main(self) -> None:
        """Follow, and print a line of a table."""
        mine = arm(self.description, self.tool)
        found = followed(mine, torch.tensor(self.posture).double(), self.stiffness, self.rotation_scale, self.seconds)
        numbers = (found.distance, found.angle, found.end_distance, found.end_angle)
        row = [self.description.stem, *(f"{value:.2f}" for value in numbers), str(found.cut), f"{found.call:.0f}"]
        print(markdown(HEADER, [row], "lrrrrrr"))
        if self.browser:
            from train.view.page import Page, show
            from train.view.shapes import Shapes
            from train.view.takes import of_arm

            takes = of_arm(found.times, found.qpos, found.tool, found.wanted)
            show(Page(self.description.stem, takes, Shapes(mine.model), port=self.port, look=AROUND))


class Followed(NamedTuple):
    """How well an arm followed.

    Attributes:
        distance, angle: largest from the reference [mm, degrees].
        end_distance, end_angle: from the goal at the end [mm, degrees].
        cut: time steps in which a torque was cut.
        call: median time of a call of the controller [µs].
        times: `(F,)` of what follows [s].
        qpos: `(F, nq)` generalised positions of the model.
        tool, wanted: `(F, 3)` where the tool was, and should have been [m].
    """

    distance: float
    angle: float
    end_distance: float
    end_angle: float
    cut: int
    call: float
    times: np.ndarray
    qpos: np.ndarray
    tool: np.ndarray
    wanted: np.ndarray


def learned() -> GMRPolicy:
    """A motion of poses that ends at zero, from three curved demonstrations of two seconds."""
    t = torch.linspace(0, 1, 41, dtype=torch.float64)[:, None]
    s = 1 - t**3 * (10 - 15 * t + 6 * t**2)
    curve = torch.sin(math.pi * s) * torch.tensor([0.03, -0.02, 0.05, 0.1, 0.1, -0.1], dtype=torch.float64)
    demos = Demonstrations([s * START * share + curve for share in (0.9, 1.0, 1.1)], dt=0.05)
    return GMRPolicy.from_demonstrations(demos, n_components=2).requires_grad_(False)


def followed(mine: Description, rest: Tensor, stiffness: float, rotation_scale: float, seconds: float) -> Followed:
    """Let an arm follow the motion that ends at a posture.

    Args:
        mine: the arm.
        rest: `(J,)` angles at the goal [rad].
        stiffness: [N/m].
        rotation_scale: see `CartesianImpedance`.
        seconds: of the trial.

    Raises:
        InvalidArgumentError: the arm does not reach the start of the motion from there.
    """
    import mujoco

    if rest.shape != (len(mine.joints),):
        raise InvalidArgumentError(f"--posture has to have {len(mine.joints)} angles, got {len(rest)}: {mine.joints}")
    end = mine.chain.jacobian(rest[None])[1][0]
    reference = references(learned(), end, round(seconds / DT))
    q = reached(mine, rest, reference)
    control = mine.impedance(q, rotation_scale=rotation_scale)
    data = mujoco.MjData(mine.model)
    mine.model.opt.timestep = DT
    data.qpos[mine.qpos] = q
    errors, times, cut = [], [], 0
    seen: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []
    for k in range(round(seconds / DT)):
        q, v = torch.from_numpy(data.qpos[mine.qpos]), torch.from_numpy(data.qvel[mine.dofs])
        mass, bias = mine.dynamics(q, v)
        began = time.perf_counter()
        asked = control(q, v, mass, bias, PoseReference(*(part[k] for part in reference)), stiffness)
        times.append(time.perf_counter() - began)
        errors.append(asked.error)
        cut += bool(asked.saturated.any())
        if k % SEEN == 0:
            seen.append((k * DT, data.qpos.copy(), asked.pose[:3, 3].numpy(), reference.x[k].numpy()))
        data.qfrc_applied[mine.dofs] = asked.torque
        mujoco.mj_step(mine.model, data)
    _, pose = mine.chain.jacobian(torch.from_numpy(data.qpos[mine.qpos])[None])
    error = torch.stack(errors)
    last = rotation_vector(end[:3, :3] @ pose[0, :3, :3].mT)
    return Followed(
        1e3 * float(torch.linalg.vector_norm(error[:, :3], dim=-1).max()),
        math.degrees(float(torch.linalg.vector_norm(error[:, 3:], dim=-1).max())),
        1e3 * float((pose[0, :3, 3] - end[:3, 3]).norm()),
        math.degrees(float(last.norm())),
        cut,
        1e6 * float(np.median(times)),
        *(np.array(part) for part in zip(*seen, strict=True)),
    )


def references(policy: GMRPolicy, end: Tensor, n_steps: int) -> PoseReference:
    """The motion `(T+1, ...)` that ends at a pose `(4, 4)`."""
    import mujoco

    goal = np.empty(4)
    mujoco.mju_mat2Quat(goal, end[:3, :3].numpy().ravel())
    shift = torch.cat([end[:3, 3], end.new_zeros(3)])
    path = rollout(policy, START, n_steps, DT)
    return PoseReference.of(path.x + shift, torch.cat([path.v, path.v[-1:]]), goal)


def reached(mine: Description, q: Tensor, reference: PoseReference) -> Tensor:
    """The joint angles near q at which the tool stands at the first point of a reference, by Newton's method.

    Raises:
        InvalidArgumentError: none were found.
    """
    for _ in range(60):
        J, now = (part[0] for part in mine.chain.jacobian(q[None]))
        turn = rotation_vector(reference.rotation[0] @ now[:3, :3].mT)
        error = torch.cat([reference.x[0] - now[:3, 3], turn])
        q = q + 0.5 * torch.linalg.pinv(J, rtol=1e-3) @ error
    if not float(error.norm()) < 1e-6:
        raise InvalidArgumentError(
            "the arm does not reach the start of the motion from this posture; give another --posture, away from its limits"
        )
    return q
