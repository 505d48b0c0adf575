"""An arm from its description: kinematics, mass, bias and limits, for `torchds.cartesian` (extra "digging").

Stability: stable.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchds.arrays import Array, like
from torchds.cartesian import CartesianImpedance
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError
from torchds.files import reason
from torchds.kinematics import Screws


class Arm:
    """A serial arm of a MuJoCo model.

    Joints that are not between the base and the tool, fingers say, are held where the model has them.

    Args:
        model: of MuJoCo; the world is the base frame.
        tool: name of the site or body at the end; by default the only body that has none behind it.

    Attributes:
        model: as given.
        joints: `(J,)` names of the joints, from the base on.
        chain: kinematics.
        range: `(J, 2)` of the joint angles [rad], infinite where there is no limit.
        torque_limit: `(J,)` both ways [N m], of actuators or joints; infinite where there is no limit.
        qpos: `(J,)` where the joints stand in `MjData.qpos`.
        dofs: `(J,)` where they stand in `MjData.qvel` and in everything that has its length.

    Raises:
        InvalidArgumentError: no such tool, several candidates, no joint before it, or ball and free joints on the way.
    """

    def __init__(self, model: Any, tool: str = "") -> None:
        import mujoco

        self.model, self._data = model, mujoco.MjData(model)
        kind, number, body = _find(model, tool)
        joints: list[int] = []
        while body > 0:
            first = model.body_jntadr[body]
            joints = [*range(first, first + model.body_jntnum[body]), *joints] if first >= 0 else joints
            body = model.body_parentid[body]
        self.joints = tuple(model.joint(j).name for j in joints)
        turning = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        if not joints or any(model.jnt_type[j] not in [int(each) for each in turning] for j in joints):
            raise InvalidArgumentError(
                f"the joints before the tool have to turn or slide, and there has to be one, got {self.joints}; fix the base "
                "of the arm in its description"
            )
        self.qpos, self.dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        limited = model.jnt_limited[joints].astype(bool)[:, None]
        self.range = torch.from_numpy(np.where(limited, model.jnt_range[joints], [-np.inf, np.inf]))
        self.torque_limit = torch.from_numpy(_limits(model, joints))
        self.chain = self._screws(kind, number)

    def dynamics(self, q: Array, v: Array) -> tuple[Tensor, Tensor]:
        """Mass matrices `(..., J, J)` [kg m²] and bias torques `(..., J)` [N m] of gravity, Coriolis and centrifugal forces.

        Args:
            q: `(..., J)` joint angles [rad].
            v: `(..., J)` joint velocities [rad/s].
        """
        import mujoco

        angles, speeds = (like(name, value, self.range).detach() for name, value in (("q", q), ("v", v)))
        n = len(self.joints)
        if angles.shape[-1:] != (n,) or speeds.shape != angles.shape:
            raise InvalidArgumentError(
                f"q and v have to be (..., {n}), got {tuple(angles.shape)} and {tuple(speeds.shape)}"
            )
        model, data, M = self.model, self._data, np.zeros((self.model.nv, self.model.nv))
        mass, bias = torch.empty(*angles.shape, n, dtype=angles.dtype), torch.empty_like(angles)
        rows = (part.reshape(-1, *part.shape[angles.ndim - 1 :]).numpy() for part in (angles, speeds, mass, bias))
        for angle, speed, m, b in zip(*rows, strict=True):
            data.qpos[self.qpos], data.qvel[self.dofs] = angle, speed
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fullM(model, data, M)
            m[:] = M[np.ix_(self.dofs, self.dofs)]
            b[:] = data.qfrc_bias[self.dofs]
        return mass, bias

    def impedance(self, posture: Array, **options: Any) -> CartesianImpedance:
        """The controller of this arm, within its torque limits; options are those of `CartesianImpedance`."""
        limit = self.torque_limit if bool(self.torque_limit.isfinite().any()) else None
        return CartesianImpedance(self.chain, posture, **{"torque_limit": limit, **options})

    def _screws(self, kind: str, number: int) -> Screws:
        """The kinematics where all joints of the arm are at zero."""
        import mujoco

        model, data, n = self.model, self._data, len(self.joints)
        data.qpos[self.qpos] = 0.0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        home, J = np.eye(4), np.zeros((2, 3, model.nv))
        home[:3, 3] = getattr(data, f"{kind}_xpos" if kind == "site" else "xpos")[number]
        home[:3, :3] = getattr(data, "site_xmat" if kind == "site" else "xmat")[number].reshape(3, 3)
        (mujoco.mj_jacSite if kind == "site" else mujoco.mj_jacBody)(model, data, J[0], J[1], number)
        linear, angular = (part[:, self.dofs] for part in J)
        axes = np.concatenate([linear - np.cross(angular, home[:3, 3:], axis=0), angular])
        data.qpos[self.qpos] = model.qpos0[self.qpos]
        assert axes.shape == (6, n)
        return Screws(axes, home)


def arm(description: str | PathLike[str] | Any, tool: str = "") -> Arm:
    """An arm from a URDF or MJCF file, a text of either, or a model of MuJoCo.

    Of a URDF the shapes are left out: meshes are not looked for, and nothing collides.

    Args:
        description: path, text, `mujoco.MjSpec` or `mujoco.MjModel`.
        tool: name of the link, body or site at the end; by default the only body that has none behind it.

    Raises:
        FileError: no such file, or no description that MuJoCo reads.
        InvalidArgumentError: see `Arm`.
        MissingPackageError: without the package mujoco.

    Example:
        >>> import torch, torchds
        >>> text = '''<mujoco><worldbody><body pos="0 0 1"><joint name="swing" axis="0 1 0"/>
        ...     <inertial mass="2" pos="0 0 -0.5" diaginertia=".1 .1 .1"/>
        ...     <site name="end" pos="0 0 -1"/></body></worldbody></mujoco>'''
        >>> pendulum = torchds.impedance.arm(text, tool="end")
        >>> pendulum.dynamics(torch.zeros(1), torch.zeros(1))[0].round(decimals=6)
        tensor([[0.6000]], dtype=torch.float64)
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingPackageError("mujoco", "digging", "an arm from its description") from error
    if isinstance(description, mujoco.MjModel):
        return Arm(description, tool)
    return Arm(description.compile() if isinstance(description, mujoco.MjSpec) else _compiled(description), tool)


def _compiled(description: str | PathLike[str]) -> Any:
    """The model of a file or text."""
    import mujoco

    is_text = isinstance(description, str) and "<" in description
    name = "the text" if is_text else str(description)
    try:
        text = str(description) if is_text else Path(description).read_text(encoding="utf-8")
        spec = mujoco.MjSpec.from_string(text) if is_text else mujoco.MjSpec.from_file(str(description))
        if "<robot" in text:
            spec.compiler.fusestatic = False  # links without joints may be tools
            for part in (*spec.geoms, *spec.meshes):
                spec.delete(part)
        return spec.compile()
    except OSError as error:
        raise FileError(f"{name} cannot be read: {reason(error)}") from error
    except ValueError as error:
        raise FileError(f"{name} is no URDF or MJCF that MuJoCo reads: {error}") from error


def _find(model: Any, tool: str) -> tuple[str, int, int]:
    """The kind of the tool, "site" or "body", its number, and the number of its body."""
    sites = [model.site(i).name for i in range(model.nsite)]
    bodies = [model.body(i).name for i in range(model.nbody)]
    if tool in sites and tool:
        number = sites.index(tool)
        return "site", number, int(model.site_bodyid[number])
    ends = sorted(set(range(1, model.nbody)) - set(model.body_parentid[1:]))
    if not tool and len(ends) == 1:
        return "body", ends[0], ends[0]
    if tool in bodies and tool:
        number = bodies.index(tool)
        return "body", number, number
    names = [each for each in (*bodies[1:], *sites) if each]
    asked = f"there is no {tool!r}" if tool else f"there are {len(ends)} ends"
    raise InvalidArgumentError(f"{asked}; give tool= one of {', '.join(names)}")


def _limits(model: Any, joints: list[int]) -> np.ndarray:
    """`(J,)` the smaller of what each joint and the motors on it allow."""
    limits = np.full(len(joints), np.inf)
    for k, j in enumerate(joints):
        if model.jnt_actfrclimited[j]:
            limits[k] = np.abs(model.jnt_actfrcrange[j]).min()
        for i in range(model.nu):
            if int(model.actuator_trntype[i]) == 0 and model.actuator_trnid[i, 0] == j:
                gear = abs(model.actuator_gear[i, 0])
                if model.actuator_forcelimited[i]:
                    limits[k] = min(limits[k], gear * np.abs(model.actuator_forcerange[i]).min())
                if (
                    model.actuator_ctrllimited[i]
                    and model.actuator_gaintype[i] == 0
                    and model.actuator_biastype[i] == 0
                ):
                    range_ = np.abs(model.actuator_ctrlrange[i]).min()
                    limits[k] = min(limits[k], gear * abs(model.actuator_gainprm[i, 0]) * range_)
    return limits
