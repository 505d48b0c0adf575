"""Cartesian impedance: the law in closed form, on the arm in MuJoCo, and on an arm with three joints."""

import functools
import math

import pytest
import torch

from torchds.cartesian import CartesianImpedance as Impedance
from torchds.errors import InvalidArgumentError
from torchds.targets import PlaneReference, PoseReference

mujoco = pytest.importorskip("mujoco")
pk = pytest.importorskip("pytorch_kinematics")

import numpy as np  # noqa: E402
import scipy.linalg  # noqa: E402

CartesianImpedance = functools.partial(Impedance, start_within=None)
EFFORTS = (40.0, 40.0, 30.0, 30.0, 15.0, 15.0, 5.0)  # [N m]
SWING, TURN, ROLL = "0 -1 0", "0 0 1", "1 0 0"  # axes of joints; swinging moves the tool in the plane, from x towards z
UPPER, LOWER, HAND = 0.4, 0.45, 0.15  # [m]
SWUNG = torch.tensor([1.2, -1.9, 0.4], dtype=torch.float64)  # the swinging joints at the start


def urdf(joints, hand):
    """An arm of joints (axis, distance from the one before [m]), its tool `hand` metres behind the last of them."""
    names = ["base", *(f"l{i}" for i in range(len(joints)))]
    body = (
        '<link name="{}"><inertial><origin xyz="0.05 0 0.02" rpy="0 0 0"/><mass value="1.5"/>'
        '<inertia ixx="0.02" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    parts = ['<link name="base"/><link name="tool"/>', *(body.format(name) for name in names[1:])]
    parts += (
        f'<joint name="j{i}" type="revolute"><parent link="{names[i]}"/><child link="l{i}"/>'
        f'<origin xyz="{distance} 0 0" rpy="0 0 0"/><axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="10"/></joint>'
        for i, (axis, distance) in enumerate(joints)
    )
    parts.append(
        f'<joint name="t" type="fixed"><parent link="{names[-1]}"/><child link="tool"/>'
        f'<origin xyz="{hand} 0 0" rpy="0 0 0"/></joint>'
    )
    return f'<robot name="arm"><mujoco><compiler fusestatic="false"/></mujoco>{"".join(parts)}</robot>'


SEVEN_JOINTS = urdf(
    [(TURN, 0.0), (SWING, 0.0), (ROLL, 0.0), (SWING, UPPER), (ROLL, 0.0), (SWING, LOWER), (ROLL, 0.0)], HAND
)
THREE_JOINTS = urdf([(SWING, 0.0), (SWING, 0.3), (SWING, 0.3)], 0.1)


@pytest.fixture(autouse=True, params=["eager", "fused"])
def backend(request, monkeypatch):
    monkeypatch.setenv("TORCHDS_BACKEND", request.param)
    if request.param == "fused":
        pytest.importorskip("numba")


@pytest.fixture(scope="module")
def chain():
    return pk.build_serial_chain_from_urdf(SEVEN_JOINTS, "tool").to(dtype=torch.float64)


@pytest.fixture(scope="module")
def start():
    """A posture in the plane: the joints that turn or roll stand at zero."""
    q = torch.zeros(7, dtype=torch.float64)
    q[[1, 3, 5]] = SWUNG
    return q


def placed():
    """(x, z, angle) of the tool at the start, by the trigonometry of three links in a plane."""
    along, angle = torch.tensor([UPPER, LOWER, HAND], dtype=torch.float64), SWUNG.cumsum(0)
    return float(along @ angle.cos()), float(along @ angle.sin()), float(angle[-1])


X, Z, ANGLE = placed()


def at(x, z, angle, batch=()):
    full = torch.tensor([x, z, angle], dtype=torch.float64).expand(*batch, 3)
    return PlaneReference(full[..., :2], full[..., 2], torch.zeros_like(full[..., :2]), torch.zeros_like(full[..., 2]))


def random_state(randn, start, batch, n=7):
    """Arms near a posture, with any mass matrix."""
    root = randn(*batch, n, n)
    mass = root @ root.mT + 0.5 * torch.eye(n, dtype=torch.float64)
    return start + 0.3 * randn(*batch, n), randn(*batch, n), mass, randn(*batch, n)


def simulate(control, q, reference, stiffness, seconds, dt, force=(0.0, 0.0, 0.0)):
    """Poses (T+1, 3) of the tool, (x, z, angle), in MuJoCo without friction, and the mass matrix at the start."""
    model = mujoco.MjModel.from_xml_string(SEVEN_JOINTS)
    model.opt.timestep = dt
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    tool, first, path = model.body("tool").id, None, []
    for _ in range(round(seconds / dt)):
        M = np.zeros((7, 7))
        mujoco.mj_fullM(model, data, M)
        first = M if first is None else first
        state = (torch.from_numpy(a.copy()) for a in (data.qpos, data.qvel, M, data.qfrc_bias))
        asked = control(*state, reference, stiffness)
        x, angle = control.in_plane(asked.pose)
        path.append(torch.cat([x, angle[None]]))
        data.qfrc_applied[:] = asked.torque
        mujoco.mj_applyFT(model, data, np.array(force), np.zeros(3), data.xpos[tool], tool, data.qfrc_applied)
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
    return torch.stack(path), torch.from_numpy(first)


@pytest.mark.slow
def test_a_released_spring_follows_the_critically_damped_modes(chain, start):
    """Λ ë + D ė + K e = 0 solved by the generalised eigenvectors of (K, Λ): each mode is (1 + ω t) exp(−ω t)."""
    control = CartesianImpedance(chain, start)
    offset = torch.tensor([2e-3, -1e-3, 4e-3], dtype=torch.float64)
    dt, reference = 1e-3, at(X + 2e-3, Z - 1e-3, ANGLE + 4e-3)
    path, M = simulate(control, start, reference, 300.0, 0.8, dt)
    J = chain.jacobian(start[None], ret_eef_pose=True)[0][0]
    inertia = torch.linalg.inv(J @ torch.linalg.solve(M, J.T)).numpy()
    K = np.diag([300.0, 1500.0, 300.0, 100.0, 30.0, 100.0])
    squares, modes = scipy.linalg.eigh(K, 0.5 * (inertia + inertia.T))  # modesᵀ Λ modes = 1
    e0 = np.array([offset[0], 0, offset[1], 0, -offset[2], 0])
    t = dt * np.arange(len(path))[:, None]
    decay = (1 + np.sqrt(squares) * t) * np.exp(-np.sqrt(squares) * t)
    predicted = (decay * (modes.T @ inertia @ e0)) @ modes.T
    error = offset + torch.tensor([X, Z, ANGLE], dtype=torch.float64) - path
    expected = torch.from_numpy(predicted[:, [0, 2, 4]]) * torch.tensor([1, 1, -1])
    assert float((error - expected).abs().max() / offset.abs().max()) < 0.02  # 1 ms steps
    assert float(error[-1].norm() / error[0].norm()) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["fused"], indirect=True)  # the other is slow, and the same
@pytest.mark.parametrize("stiffness", [150.0, 450.0])
def test_a_constant_force_displaces_by_force_over_stiffness(chain, start, stiffness):
    control = CartesianImpedance(chain, start)
    path, _ = simulate(control, start, at(X, Z, ANGLE), stiffness, 6.0, 4e-3, force=(6.0, 0.0, -3.0))
    moved = path[-1, :2] - torch.tensor([X, Z], dtype=torch.float64)
    torch.testing.assert_close(moved, torch.tensor([6.0, -3.0], dtype=torch.float64) / stiffness, rtol=2e-3, atol=0)


def three_joints():
    return pk.build_serial_chain_from_urdf(THREE_JOINTS, "tool").to(dtype=torch.float64)


@pytest.mark.parametrize("joints", [3, 7])
def test_damping_is_twice_the_root_of_stiffness_in_the_metric_of_the_mass(chain, start, randn, joints):
    """D_q M⁻¹ D_q = 4 ζ² K_q with K_q = Jᵀ K J, also where the task inertia does not exist (three joints)."""
    arm = chain if joints == 7 else three_joints()
    posture = start if joints == 7 else torch.tensor([0.3, 0.8, -0.5], dtype=torch.float64)
    control = CartesianImpedance(arm, posture, damping_ratio=0.7, posture_stiffness=0.0, posture_damping=0.0)
    q, _, mass, bias = random_state(randn, posture, (joints,), joints)
    q, mass, bias = q[:1].expand_as(q), mass[:1].expand_as(mass), bias[:1].expand_as(bias)
    reference, speeds = at(0.5, 0.2, 0.1), torch.eye(joints, dtype=torch.float64)
    moving = control(q, speeds, mass, bias, reference, 200.0).torque
    resting = control(q, torch.zeros_like(speeds), mass, bias, reference, 200.0).torque
    D = (resting - moving).T
    J = arm.jacobian(q[:1], ret_eef_pose=True)[0][0]
    K = torch.diag(torch.tensor([200.0, 1500.0, 200.0, 100.0, 20.0, 100.0], dtype=torch.float64))
    torch.testing.assert_close(D @ torch.linalg.solve(mass[0], D), 4 * 0.49 * J.T @ K @ J, rtol=1e-7, atol=1e-6)
    torch.testing.assert_close(D, D.T, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("joints", [3, 7])
def test_a_moving_reference_pulls_by_the_damping_also_where_the_tool_cannot_follow(chain, randn, joints):
    """Jᵀ D ẋ^ref, D = 2 ζ √K ((√K J M⁻¹ Jᵀ √K)^½)⁺ √K; the seven joints are stretched out."""
    arm, angles = (chain, torch.zeros(7)) if joints == 7 else (three_joints(), torch.tensor([0.3, 0.8, -0.5]))
    q, v, mass, bias = random_state(randn, angles.double(), (), joints)
    q, v, mass, bias = (a.expand(6, *a.shape) for a in (angles.double(), v, mass, bias))
    control = CartesianImpedance(arm, angles.double(), damping_ratio=0.7)
    still = PoseReference(torch.zeros(3).double(), torch.eye(3).double(), *torch.zeros(2, 6, 3).double())
    moving = still._replace(v=torch.eye(6).double()[:, :3], rate=torch.eye(6).double()[:, 3:])
    pull = control(q, v, mass, bias, moving, 200.0).torque - control(q, v, mass, bias, still, 200.0).torque
    J = arm.jacobian(q[:1], ret_eef_pose=True)[0][0]
    root = torch.tensor([200.0] * 3 + [20.0] * 3).double().sqrt().diag()
    squares, modes = torch.linalg.eigh(root @ J @ torch.linalg.solve(mass[0], J.T) @ root)
    inverse = torch.where(squares > 1e-10 * squares[-1], squares.abs().rsqrt(), 0.0)
    assert int((inverse == 0).sum()) == (3 if joints == 3 else 2)
    D = 1.4 * root @ (modes * inverse) @ modes.T @ root
    torch.testing.assert_close(pull, D @ J, rtol=1e-6, atol=1e-6)


def test_the_nullspace_torque_does_not_accelerate_the_tool(chain, start, randn):
    q, v, mass, bias = random_state(randn, start, (50,))
    asked = CartesianImpedance(chain, start)(q, v, mass, bias, at(0.6, 0.2, 0.0), 300.0)
    J = chain.jacobian(q, ret_eef_pose=True)[0]
    acceleration = J @ torch.linalg.solve(mass, asked.nullspace.unsqueeze(-1))
    assert asked.nullspace.abs().amax(-1).min() > 1e-3
    assert float(acceleration.abs().max()) < 1e-10


def test_a_tool_that_moves_with_its_reference_is_not_damped(chain, start, randn):
    q = start.expand(1, 7)
    v = 0.1 * start.new_tensor([[0, 1, 0, -0.5, 0, 0.8, 0]])
    J, pose = chain.jacobian(q, ret_eef_pose=True)
    xdot = (J @ v.unsqueeze(-1)).squeeze(-1)
    reference = PlaneReference(
        pose[..., (0, 2), 3], torch.full((1,), ANGLE, dtype=torch.float64), xdot[..., (0, 2)], -xdot[..., 4]
    )
    control = CartesianImpedance(chain, start, posture_damping=0.0)
    mass = torch.eye(7, dtype=torch.float64).expand(1, 7, 7)
    asked = control(q, v, mass, torch.zeros_like(q), reference, 300.0)
    assert float(asked.torque.abs().max()) < 1e-4  # offsets of the chain are rounded to float32: 1500 N/m × 1e-8 m


def test_torques_stay_within_limits_and_say_so(chain, start, randn):
    q, v, mass, bias = random_state(randn, start, (20,))
    limit = torch.tensor(EFFORTS, dtype=torch.float64)
    free = CartesianImpedance(chain, start)(q, v, mass, bias, at(0.9, 0.5, 1.0), 450.0)
    held = CartesianImpedance(chain, start, torque_limit=limit)(q, v, mass, bias, at(0.9, 0.5, 1.0), 450.0)
    assert (free.torque.abs() > limit).any() and (held.torque.abs() <= limit).all()
    assert not free.saturated.any()
    torch.testing.assert_close(held.saturated, free.torque.abs() > limit)
    torch.testing.assert_close(held.torque[~held.saturated], free.torque[~held.saturated])


def test_a_batch_equals_a_loop(chain, start, randn):
    control = CartesianImpedance(chain, start, torque_limit=EFFORTS)
    state = random_state(randn, start, (2, 3))
    stiffness = 100 + 300 * randn(2, 3).abs()
    together = control(*state, at(0.6, 0.2, 0.1, (2, 3)), stiffness)
    for i in range(2):
        for j in range(3):
            alone = control(*(a[i, j] for a in state), at(0.6, 0.2, 0.1), stiffness[i, j])
            for one, all_ in zip(alone, together, strict=True):
                torch.testing.assert_close(one, all_[i, j], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("turn", [0.0, 1e-10, 0.5, 3.0])
def test_the_error_of_the_angle_is_exact(chain, start, turn):
    control, zero = CartesianImpedance(chain, start), torch.zeros(7, dtype=torch.float64)
    asked = control(start, zero, torch.eye(7, dtype=torch.float64), zero, at(X, Z, ANGLE + turn), 100.0)
    expected = torch.tensor([0, 0, 0, 0, -turn, 0], dtype=torch.float64)
    torch.testing.assert_close(asked.error, expected, atol=3e-7, rtol=0)
    torch.testing.assert_close(float(control.in_plane(asked.pose)[1]), ANGLE, atol=3e-7, rtol=0)


def test_an_arm_in_a_singular_posture_gets_finite_torques(chain, start):
    control, zero = CartesianImpedance(chain, start), torch.zeros(7, dtype=torch.float64)
    asked = control(zero, zero + 0.1, torch.eye(7, dtype=torch.float64), zero, at(0.6, 0.2, 0.0), 300.0)
    assert asked.torque.isfinite().all()


def turned(angle, axis):
    """The pose of a frame that is turned about an axis."""
    pose = torch.eye(4, dtype=torch.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    pose[i, i] = pose[j, j] = math.cos(angle)
    pose[j, i], pose[i, j] = math.sin(angle), -math.sin(angle)
    return pose


def space(pose):
    return PoseReference(pose[:3, 3], pose[:3, :3], torch.zeros(3).double(), torch.zeros(3).double())


def test_a_pose_reference_is_a_plane_reference_where_both_are_the_same(chain, start, randn):
    """With the plane's stiffness outside of it equal to that in it, and the rotation's too."""
    state = random_state(randn, start, (5,))
    control = CartesianImpedance(chain, start, stiffness_outside=(200.0, 20.0), rotation_scale=0.1)
    flat = PlaneReference(randn(5, 2), randn(5), randn(5, 2), randn(5))
    for one, other in zip(control(*state, flat, 200.0), control(*state, control.plane.pose(flat), 200.0), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


def test_a_pose_is_held_and_its_errors_are_exact(chain, start):
    zero, control = torch.zeros(7, dtype=torch.float64), CartesianImpedance(chain, start)
    (_, pose), eye = chain.jacobian(start[None], ret_eef_pose=True), torch.eye(7, dtype=torch.float64)
    for axis in range(3):
        for angle in (0.0, 1e-9, 0.7, -3.1):
            wanted = pose[0].clone()
            wanted[:3, :3] = turned(angle, axis)[:3, :3] @ pose[0, :3, :3]
            wanted[axis, 3] += 0.03
            expected = torch.zeros(6, dtype=torch.float64)
            expected[axis], expected[3 + axis] = 0.03, angle
            error = control(start, zero, eye, zero, space(wanted), 100.0).error
            torch.testing.assert_close(error, expected, atol=3e-7, rtol=0)


def test_a_tool_is_the_same_as_a_longer_chain(chain, start, randn):
    """Torques at the tool equal those of the arm whose last link carries it."""
    tool = turned(0.5, 0) @ turned(-0.3, 2)
    tool[:3, 3] = torch.tensor([0.1, -0.05, 0.2])
    longer = CartesianImpedance(chain, start, tool=tool)
    state = random_state(randn, start, (4,))
    reference = space(turned(0.2, 1))
    asked = longer(*state, reference, 300.0)
    _, pose = chain.jacobian(state[0], ret_eef_pose=True)
    torch.testing.assert_close(asked.pose, pose @ tool, atol=1e-7, rtol=0)
    eye, still = torch.eye(7, dtype=torch.float64).expand(4, 7, 7), torch.zeros_like(state[0])
    quiet = CartesianImpedance(chain, start, tool=tool, posture_stiffness=0.0)
    found = quiet(state[0], still, eye, still, reference, 300.0)
    h = 1e-6  # the gradient of the spring's energy, by differences along each joint
    for j in range(7):
        step = torch.zeros(7, dtype=torch.float64)
        step[j] = h
        ahead, behind = (quiet(state[0] + s * step, still, eye, still, reference, 300.0).pose for s in (1, -1))
        moved = (ahead - behind)[..., :3, 3] / (2 * h)
        push = 300.0 * (moved * found.error[:, :3]).sum(-1)
        spin = (ahead - behind)[..., :3, :3] / (2 * h) @ found.pose[..., :3, :3].mT
        axis = torch.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)
        torch.testing.assert_close(
            found.torque[:, j], push + 30.0 * (axis * found.error[:, 3:]).sum(-1), rtol=1e-5, atol=1e-4
        )


def test_a_tool_far_from_its_reference_is_refused_once(chain, start):
    zero, eye = torch.zeros(7, dtype=torch.float64), torch.eye(7, dtype=torch.float64)
    near, far, flipped = at(X, Z, ANGLE), at(X + 0.4, Z, ANGLE), at(X, Z, ANGLE + 3.1)
    pose = Impedance(chain, start, start_within=None)(start, zero, eye, zero, near, 100.0).pose
    upside_down = pose[:3, :3] @ torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    nowhere = PoseReference(torch.full_like(pose[:3, 3], torch.nan), pose[:3, :3], 0 * pose[:3, 3], 0 * pose[:3, 3])
    control = Impedance(chain, start)
    for wanted, words in (
        (far, r"begins 0\.4 m and .*° from its reference"),
        (flipped, r"m and 178° from.*at most.*30°"),
        (nowhere._replace(x=pose[:3, 3], rotation=upside_down), r"m and 180° from"),
        (nowhere, r"begins nan m"),
    ):
        with pytest.raises(InvalidArgumentError, match=words):
            control(start, zero, eye, zero, wanted, 100.0)
    control(start, zero, eye, zero, near, 100.0)
    control(start, zero, eye, zero, far, 100.0)  # pushed away on its way
    control.reset()
    with pytest.raises(InvalidArgumentError, match=r"tool=control\.aligned\(q, reference\)"):
        control(start, zero, eye, zero, flipped, 100.0)
    with pytest.raises(InvalidArgumentError, match=r"begins 0\.4 m"):
        Impedance(chain, start, start_within=(0.3, 1.0))(start, zero, eye, zero, far, 100.0)


def test_the_aligned_tool_has_the_axes_of_the_reference(chain, start):
    zero, eye = torch.zeros(7, dtype=torch.float64), torch.eye(7, dtype=torch.float64)
    flipped = at(X, Z, ANGLE + 3.1)
    control = Impedance(chain, start)
    other = Impedance(chain, start, tool=control.aligned(start, flipped))
    asked = other(start, zero, eye, zero, flipped, 100.0)
    assert float(asked.error.abs().max()) < 1e-6
    torch.testing.assert_close(float(other.in_plane(asked.pose)[1]), ANGLE + 3.1, atol=1e-6, rtol=0)


def test_bad_arguments_are_refused_by_name(chain, start, randn):
    for options, message in (
        ({"plane": "zx"}, "plane has to be"),
        ({"damping_ratio": -1.0}, "damping_ratio has to be ≥ 0"),
        ({"stiffness_outside": (1.0, -2.0)}, r"stiffness_outside\[1\]"),
        ({"torque_limit": [1.0]}, "torque_limit has to be 7 positive numbers"),
        ({"tool": [1.0]}, r"tool has to be a pose \(4, 4\)"),
        ({"tool": -torch.eye(4)}, r"tool has to be a pose \(4, 4\)"),
    ):
        with pytest.raises(InvalidArgumentError, match=message):
            CartesianImpedance(chain, start, **options)
    control, state = CartesianImpedance(chain, start), random_state(randn, start, (2,))
    with pytest.raises(InvalidArgumentError, match="stiffness has to be ≥ 0"):
        control(*state, at(0.6, 0.2, 0.0), -1.0)
    with pytest.raises(InvalidArgumentError, match="mass has to be"):
        control(*state[:2], state[2][0], state[3], at(0.6, 0.2, 0.0), 1.0)
    with pytest.raises(InvalidArgumentError, match=r"q has to be .* in torch.float64"):
        control(state[0].float(), *state[1:], at(0.6, 0.2, 0.0), 1.0)
