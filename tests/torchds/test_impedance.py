"""Impedance control against Eq. 29-33 step by step in numpy, the continuous equations, and what physics demands."""

import re

import numpy as np
import pytest
import scipy.integrate
import torch
from torch import nn
from torch.func import functional_call
from torch.testing import assert_close

from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.impedance import ImpedanceControlled, clamped_share, injected_energy
from torchds.plants import Command, PointMass

FORMS = pytest.mark.parametrize("form", ["implicit", "explicit"])


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


def field(t, x, v):
    """A force that depends on all it may depend on; for numpy and torch."""
    return 2.0 * np.sin(3 * t) + 0.5 * x - 0.3 * v


def make_policy(Q, batch=()):
    """A slow motion to the origin, with a stiffness between 5 and 15 where it passes."""
    values = {
        "priors": [0.5, 0.5],
        "means": [[-0.9, 0.6], [0.5, -0.4]],
        "covariances": [[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]],
        "A": [[[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]],
        "b": [[0.3, -0.4], [0.5, -0.1]],
        "stiffness_A": np.array([[[1.3, -0.7], [-1.1, 2.0]], [[0.4, 0.6], [0.9, -0.8]]])[:, :Q],
        "stiffness_b": np.array([[12.0, 7.0], [8.0, 11.0]])[:, :Q],
    }
    policy = GMRPolicy(**{name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()})
    if batch:
        theta = policy.pack().detach()
        generator = torch.Generator().manual_seed(6)
        policy.unpack(theta + 0.1 * torch.randn(*batch, len(theta), generator=generator, dtype=torch.float64))
    return policy


# ---------------------------------------------------------------------- Eq. 29-33 in numpy


def simulate(reference, v_ref, stiffness, dt, form, mass, damping, force):
    """x, v, a and u of one trajectory: (T+1, D) reference, (T, D) its velocities, (T, D) stiffness."""
    x, v = reference[0], np.zeros(reference.shape[-1])
    X, V, accelerations = [x], [v], [np.zeros_like(x)]
    for t in range(len(v_ref)):
        F = force(t * dt, x, v) if force else np.zeros_like(x)
        s = stiffness[t]
        d = 2 * np.sqrt(s * mass)
        if form == "explicit":
            u = s * (reference[t + 1] - x) + d * (v_ref[t] - v)
            a = (u + F - damping * v) / mass
            v = v + a * dt
            x = x + v * dt
        else:
            before = v_ref[t - 1] if t else np.zeros_like(x)
            D = len(x)
            I, O = np.eye(D), np.zeros((D, D))
            # Unknown are x_t, v_t, a_t and u_t; the rows are Eq. 29, 30, 31 and 33.
            matrix = np.block(
                [
                    [I, -dt * I, O, O],
                    [O, I, -dt * I, O],
                    [O, O, mass * I, -I],
                    [np.diag(s), np.diag(d), O, I],
                ]
            )
            right = np.concatenate([x, v, F - damping * v, s * reference[t] + d * before])
            x, v, a, u = np.split(np.linalg.solve(matrix, right), 4)
        X.append(x)
        V.append(v)
        accelerations.append(a)
    return np.array(X), np.array(V), np.array(accelerations)


@FORMS
@pytest.mark.parametrize("Q", [0, 1, 2])
@pytest.mark.parametrize("force", [None, field])
@pytest.mark.parametrize(("mass", "damping"), [(1.0, 1.0), (2.5, 0.0)])
def test_a_tracked_motion_is_equations_29_to_33(form, Q, force, mass, damping):
    policy, T, dt = make_policy(Q), 60, 0.05
    plant = ImpedanceControlled(PointMass(mass, damping, force), None if Q else tensor(9.0, 4.0), form=form)
    path = rollout(policy, tensor(-1.2, 0.9), T, dt, plant=plant)
    bare = rollout(policy, tensor(-1.2, 0.9), T, dt)
    constant = np.broadcast_to([9.0, 4.0], (T, 2))
    s = policy.stiffness(bare.x[:-1]).detach().numpy() * np.ones(2) if Q else constant
    X, V, accelerations = simulate(bare.x.detach().numpy(), bare.v.detach().numpy(), s, dt, form, mass, damping, force)
    np.testing.assert_allclose(path.x.detach(), X, rtol=0, atol=1e-11)
    np.testing.assert_allclose(path.plant.v.detach(), V, rtol=0, atol=1e-11)
    np.testing.assert_allclose(path.plant.acceleration.detach(), accelerations, rtol=0, atol=1e-9)
    np.testing.assert_allclose(path.plant.stiffness[1:].detach(), s, rtol=0, atol=1e-11)
    assert np.abs(X - bare.x.detach().numpy()).max() > 0.05  # it does not track perfectly


@FORMS
@pytest.mark.parametrize("backend", ["eager", "auto"])
def test_outputs_beyond_the_axes_move_nothing(randn, form, backend):
    policy = make_policy(1).requires_grad_(False)
    values = {name: getattr(policy, name) for name in ("priors", "means", "covariances", "stiffness_A", "stiffness_b")}
    more = GMRPolicy(A=torch.cat([policy.A, randn(2, 1, 2)], 1), b=torch.cat([policy.b, randn(2, 1)], 1), **values)
    plant = ImpedanceControlled(PointMass(), form=form)
    x0 = randn(5, 2)
    with torch.no_grad():
        found, usual = (rollout(each, x0, 20, 0.05, plant=plant, backend=backend) for each in (more, policy))
    assert_close(found.x, usual.x, rtol=1e-12, atol=1e-12)
    assert_close(found.plant.v, usual.plant.v, rtol=1e-12, atol=1e-12)


@FORMS
@pytest.mark.parametrize("batch", [(), (3,), (2, 2)])
@pytest.mark.parametrize("points", [(), (4,), (2, 2)])
@pytest.mark.slow
def test_a_batch_equals_a_loop_of_single_roll_outs(randn, form, batch, points):
    policy, x0 = make_policy(2, batch), randn(*points, 2)
    plant = ImpedanceControlled(PointMass(force=lambda t, x, v: x.flip(-1) - 0.1 * t * v), form=form)
    path = rollout(policy, x0, 12, 0.05, plant=plant)
    for i in np.ndindex(batch):
        single = make_policy(2).unpack(policy.pack()[i])
        for j in np.ndindex(points):
            alone = rollout(single, x0[j], 12, 0.05, plant=plant)
            assert_close(path.x[i + j], alone.x, rtol=1e-11, atol=1e-12)
            assert_close(path.v[i + j], alone.v, rtol=1e-11, atol=1e-12)
            for together, other in zip(path.plant, alone.plant, strict=True):
                assert_close(together[i + j], other, rtol=1e-10, atol=1e-11)


@FORMS
@pytest.mark.slow
def test_the_error_against_the_continuous_equations_falls_with_the_time_step(form):
    """Euler's method is of first order: half the step, half the error."""
    policy, duration, mass, damping = make_policy(2), 1.5, 1.3, 0.7
    x0 = tensor(-1.2, 0.9)

    def motion(t, y):
        reference, x, v = np.split(y, 3)
        with torch.no_grad():
            v_ref = policy(torch.from_numpy(reference)).numpy()
            s = policy.stiffness(torch.from_numpy(reference)).numpy()
        u = s * (reference - x) + 2 * np.sqrt(s * mass) * (v_ref - v)
        return np.concatenate([v_ref, v, (u + field(t, x, v) - damping * v) / mass])

    start = np.concatenate([x0, x0, [0, 0]])
    exact = scipy.integrate.solve_ivp(motion, (0, duration), start, rtol=1e-10, atol=1e-12).y[2:4, -1]
    plant = ImpedanceControlled(PointMass(mass, damping, field), form=form)
    errors = []
    for n in (100, 200, 400, 800):
        with torch.no_grad():
            x = rollout(policy, x0, n, duration / n, plant=plant).x[-1].numpy()
        errors.append(np.linalg.norm(x - exact))
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert np.abs(orders - 1).max() < 0.1
    assert errors[-1] < 5e-3


# ---------------------------------------------------------------------- what physics demands


def track(plant, x0, target, n_steps, dt):
    """Positions and velocities (T+1, ...) of a plant that is pulled to a reference at rest."""
    state, zero = plant.reset(x0), torch.zeros_like(x0)
    states = [state]
    for i in range(n_steps):
        state = plant.step(state, Command(target, target, zero, zero, None, i * dt, dt))
        states.append(state)
    return torch.stack([s.x for s in states]), torch.stack([s.v for s in states])


@pytest.mark.parametrize("stiffness", [0.5, 10.0, 400.0])
@pytest.mark.parametrize("mass", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("angle", [0.01, 0.3, 10.0])
@pytest.mark.slow
def test_a_step_response_does_not_overshoot(stiffness, mass, angle):
    """Critical damping; the implicit form keeps it for any time step, `angle` of the natural frequency."""
    plant = ImpedanceControlled(PointMass(mass, 0.0), stiffness)
    x, _ = track(plant, tensor(0.0), tensor(1.0), int(10 / angle) + 10, angle / (stiffness / mass) ** 0.5)
    assert x.max() <= 1 + 1e-12
    assert (x.diff(dim=0) >= -1e-12).all()
    assert x[-1] > 0.99


@FORMS
@pytest.mark.slow
def test_a_step_response_is_that_of_critical_damping(form):
    s, mass, dt = 30.0, 2.0, 1e-3
    x, _ = track(ImpedanceControlled(PointMass(mass, 0.0), s, form=form), tensor(0.0), tensor(1.0), 2000, dt)
    omega, t = np.sqrt(s / mass), dt * np.arange(2001)
    np.testing.assert_allclose(x[:, 0], 1 - (1 + omega * t) * np.exp(-omega * t), atol=omega * dt)


@pytest.mark.parametrize(("damping", "dt"), [(0.0, 0.01), (0.0, 0.3), (0.0, 50.0), (1.0, 0.01), (1.0, 0.5)])
@pytest.mark.parametrize("mass", [0.5, 3.0])
def test_energy_never_grows_with_constant_stiffness_and_a_reference_at_rest(randn, damping, dt, mass):
    """Spring and damper are solved for where they lead to, so they take energy at any time step."""
    s = 10 * torch.rand(50, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    plant = ImpedanceControlled(PointMass(mass, damping), s)
    state, target, zero = plant.reset(randn(50, 2)), randn(50, 2), torch.zeros(50, 2, dtype=torch.float64)
    state = state._replace(v=3 * randn(50, 2))
    energies = []
    for i in range(100):
        energies.append(0.5 * mass * state.v.square() + 0.5 * s * (state.x - target).square())
        state = plant.step(state, Command(target, target, zero, zero, None, i * dt, dt))
    energy = torch.stack(energies)
    assert (energy.diff(dim=0) <= 1e-14 * energy[0]).all()
    assert (energy[-1] < 0.9 * energy[0]).sum() > 40


@pytest.mark.slow
def test_the_stiffer_the_closer_the_plant_follows():
    policy, x0 = make_policy(0), tensor(-1.2, 0.9)
    distances = []
    for s in (1.0, 10.0, 100.0, 1e4, 1e8):
        path = rollout(policy, x0, 100, 0.02, plant=ImpedanceControlled(PointMass(), s))
        distances.append((path.x - path.reference).norm(dim=-1).max().item())
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 0.05  # two time steps behind: the implicit form looks at the reference before the step


# ---------------------------------------------------------------------- where the stiffness comes from


@FORMS
def test_one_row_counts_for_all_axes(form):
    one, x0 = make_policy(1), tensor([-1.2, 0.9], [0.3, 0.4])
    two = GMRPolicy(
        one.priors,
        one.means,
        one.covariances,
        one.A,
        one.b,
        one.stiffness_A.expand(-1, 2, -1),
        one.stiffness_b.expand(-1, 2),
    )
    plant = ImpedanceControlled(PointMass(force=field), form=form)
    isotropic, diagonal = (rollout(policy, x0, 20, 0.05, plant=plant) for policy in (one, two))
    assert isotropic.stiffness.shape == (2, 20, 1)
    assert isotropic.plant.stiffness.shape == (2, 21, 2)
    for mine, theirs in zip(isotropic.plant, diagonal.plant, strict=True):
        assert_close(mine, theirs, rtol=1e-12, atol=1e-12)
    different = rollout(make_policy(2), x0, 20, 0.05, plant=plant)
    assert not torch.allclose(different.x, diagonal.x, atol=1e-3)


@FORMS
def test_a_constant_of_the_controller_equals_constant_rows_of_the_policy(form):
    bare, x0 = make_policy(0), tensor(-1.2, 0.9)
    rows = GMRPolicy(
        bare.priors,
        bare.means,
        bare.covariances,
        bare.A,
        bare.b,
        torch.zeros(2, 2, 2, dtype=torch.float64),
        tensor([8.0, 3.0], [8.0, 3.0]),
    )
    tracked = rollout(rows, x0, 30, 0.05, plant=ImpedanceControlled(PointMass(), form=form))
    for policy in (bare, make_policy(2)):  # a constant goes before what the policy says
        plant = ImpedanceControlled(PointMass(), tensor(8.0, 3.0), form=form)
        assert_close(rollout(policy, x0, 30, 0.05, plant=plant).x, tracked.x, rtol=1e-12, atol=1e-13)
    number = rollout(bare, x0, 30, 0.05, plant=ImpedanceControlled(PointMass(), 8.0, form=form))
    assert_close(number.x[:, 0], tracked.x[:, 0], rtol=1e-12, atol=1e-13)
    assert not torch.allclose(number.x[:, 1], tracked.x[:, 1])


def test_the_stiffness_of_the_policy_is_applied_within_its_bounds():
    policy = make_policy(2)
    with torch.no_grad():
        policy.stiffness_b.copy_(tensor([-5.0, 4.0], [900.0, 30.0]))
    path = rollout(policy, tensor(-1.2, 0.9), 40, 0.05, plant=ImpedanceControlled(PointMass(), low=1.0, high=60.0))
    asked, applied = path.stiffness, path.plant.stiffness[1:]
    assert asked.min() < 0
    assert asked.max() > 60
    assert applied.min() == 1
    assert applied.max() == 60
    inside = (asked > 1) & (asked < 60)
    assert inside.any()
    assert torch.equal(applied[inside], asked[inside])
    free = rollout(policy, tensor(-1.2, 0.9), 40, 0.05, plant=ImpedanceControlled(PointMass()))
    assert free.plant.stiffness.min() == 0  # never negative
    assert free.plant.stiffness.max() == asked.max()
    assert free.x.isfinite().all()


@pytest.mark.parametrize("rows", [(0, 0), (1, 0), (1, 1), (0, 1)])
def test_axes_may_follow_any_of_the_rows(rows):
    path = rollout(make_policy(2), tensor(-1.2, 0.9), 10, 0.05, plant=ImpedanceControlled(PointMass(), rows=rows))
    for axis, row in enumerate(rows):
        assert torch.equal(path.plant.stiffness[1:, axis], path.stiffness[:, row])


def test_the_stiffness_follows_what_is_asked_for_at_a_limited_rate():
    policy, dt, rate = make_policy(2), 0.05, 2.0
    path = rollout(policy, tensor(-1.2, 0.9), 40, dt, plant=ImpedanceControlled(PointMass(), max_rate=rate, high=13.0))
    asked = path.stiffness.detach().clamp(0.0, 13.0).numpy()
    applied = [asked[0]]
    for s in asked[1:]:
        applied.append(applied[-1] + np.clip(s - applied[-1], -rate * dt, rate * dt))
    np.testing.assert_allclose(path.plant.stiffness[1:].detach(), applied, rtol=1e-12)
    steps = np.abs(np.diff(applied, axis=0))
    assert (steps > 0.99 * rate * dt).any()  # the limit had a say
    assert (np.abs(np.array(applied) - asked) < 1e-9).any()


def test_only_a_growing_stiffness_of_a_stretched_spring_injects_energy():
    policy, x0 = make_policy(2, (3,)), tensor([-1.2, 0.9], [0.4, 0.3])
    path = rollout(policy, x0, 30, 0.05, plant=ImpedanceControlled(PointMass(), low=4.0, high=12.0))
    energy = injected_energy(path)
    s, stretch = (value.detach().numpy() for value in (path.plant.stiffness, path.reference - path.plant.x))
    for i in np.ndindex(3, 2):
        expected = sum(
            max(0.0, 0.5 * ((s[i][t + 1] - s[i][t]) * stretch[i][t] ** 2).sum()) for t in range(1, len(s[i]) - 1)
        )
        assert energy[i].item() == pytest.approx(expected, rel=1e-11)
    assert energy.min() > 0
    constant = rollout(policy, x0, 30, 0.05, plant=ImpedanceControlled(PointMass(), 9.0))
    assert not injected_energy(constant).any()


def test_the_clamped_share_counts_steps_and_rows_outside_the_bounds():
    policy, plant = make_policy(2, (3,)), ImpedanceControlled(PointMass(), low=9.0, high=12.0)
    path = rollout(policy, tensor(-1.2, 0.9), 30, 0.05, plant=plant)
    asked = path.stiffness.detach().numpy()
    expected = [np.mean([not 9.0 <= s <= 12.0 for s in asked[r].ravel()]) for r in range(3)]
    np.testing.assert_allclose(clamped_share(path, plant), expected, rtol=1e-12)
    assert min(expected) > 0
    assert max(expected) < 1
    with pytest.raises(InvalidArgumentError, match="this roll-out is of a policy without stiffness; nothing was"):
        clamped_share(rollout(make_policy(0), tensor(-1.2, 0.9), 3, 0.05), plant)


# ---------------------------------------------------------------------- derivatives, dtype, refusals


class Tracked(nn.Module):
    def __init__(self, policy, plant):
        super().__init__()
        self.policy, self.plant = policy, plant

    def forward(self, x0):
        path = rollout(self.policy, x0, n_steps=4, dt=0.1, plant=self.plant)
        return path.x, path.v, path.plant.acceleration, path.stiffness


@FORMS
@pytest.mark.parametrize("Q", [1, 2])
@pytest.mark.slow
def test_a_tracked_motion_differentiates(form, Q):
    policy = make_policy(Q)
    module = Tracked(policy, ImpedanceControlled(PointMass(force=lambda t, x, v: x * v + t), form=form))
    names = [name for name, _ in policy.named_parameters()]
    inputs = [p.detach().clone().requires_grad_() for p in (tensor(-1.2, 0.9), *policy.parameters())]
    torch.autograd.gradcheck(
        lambda x0, *values: functional_call(
            module, {f"policy.{name}": value for name, value in zip(names, values, strict=True)}, (x0,)
        ),
        tuple(inputs),
    )


def test_gradients_stay_finite_where_the_policy_asks_for_a_negative_stiffness():
    policy = make_policy(1)
    with torch.no_grad():
        policy.stiffness_b.sub_(10.0)
    path = rollout(policy, tensor(-1.2, 0.9), 20, 0.1, plant=ImpedanceControlled(PointMass()))
    assert path.stiffness.min() < 0 < path.stiffness.max()
    path.x.square().sum().backward()
    for p in policy.parameters():
        assert p.grad.isfinite().all()
    assert policy.stiffness_b.grad.any()


@FORMS
def test_float32_stays_float32_and_close(form):
    policy, x0 = make_policy(2), tensor(-1.2, 0.9)
    plant = ImpedanceControlled(PointMass(force=field), form=form)
    double = rollout(policy, x0, 30, 0.05, plant=plant)
    single = rollout(make_policy(2).float(), x0.float(), 30, 0.05, plant=plant)
    assert {value.dtype for value in (single.x, single.v, *single.plant)} == {torch.float32}
    assert_close(single.x.double(), double.x, rtol=1e-4, atol=1e-4)
    constant = rollout(make_policy(0).float(), x0.float(), 3, 0.05, plant=ImpedanceControlled(PointMass(), x0 + 2))
    assert constant.x.dtype == torch.float32


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"form": "euler"}, "form has to be 'implicit' or 'explicit', got 'euler'"),
        ({"low": -1.0}, "low and high have to be 0 ≤ low ≤ high, got low=-1.0 and high=inf"),
        ({"low": 5.0, "high": 4.0}, "low and high have to be 0 ≤ low ≤ high, got low=5.0 and high=4.0"),
        ({"low": float("nan")}, "low and high have to be 0 ≤ low ≤ high, got low=nan"),
        ({"max_rate": 0.0}, "max_rate has to be positive, got 0.0"),
        ({"stiffness": -3.0}, "a constant stiffness has to be ≥ 0, got -3.0"),
        ({"stiffness": float("nan")}, "a constant stiffness has to be ≥ 0, got nan"),
        ({"stiffness": tensor(1.0, -1.0)}, "a constant stiffness has to be ≥ 0, got tensor([ 1., -1.]"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(InvalidArgumentError, match=re.escape(message)):
        ImpedanceControlled(PointMass(), **options)


def test_policies_that_cannot_say_how_stiff_each_axis_is_are_refused(random_policy):
    plant, x0 = ImpedanceControlled(PointMass()), torch.zeros(2, dtype=torch.float64)
    with pytest.raises(
        InvalidArgumentError, match=r"a policy without stiffness cannot control 2 axes.*: make the policy"
    ):
        rollout(make_policy(0), x0, 3, 0.1, plant=plant)
    message = "stiffness rows cannot control 2 axes by rows=.*stiffness_dim=1 .* or 2, or give .* a constant stiffness"
    for Q, rows in ((3, None), (2, (0, 2)), (1, (0, 1)), (2, (0,)), (2, (-1, 0))):
        with pytest.raises(InvalidArgumentError, match=f"{Q} {message}"):
            rollout(random_policy(Q=Q), x0, 3, 0.1, plant=ImpedanceControlled(PointMass(), rows=rows))
