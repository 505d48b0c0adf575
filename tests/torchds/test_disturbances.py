"""Noise of sensors and pushes: what is drawn, and what it does to a plant, against a loop in numpy and in all backends."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from tests.torchds.kernels.comparison import both, close, needs_numba
from torchds import disturbances, rollout
from torchds.errors import InvalidArgumentError
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled
from torchds.plants import PointMass

T, DT = 40, 0.05


@pytest.fixture(autouse=True)
def without_gradients():
    with torch.no_grad():
        yield


def chance(*shape, seed=0, **sizes):
    sizes = {"sensor": 0.02, "push": 3.0, "duration": 0.5, **sizes}
    return disturbances.draw(shape, T, DT, generator=torch.Generator().manual_seed(seed), **sizes)


def test_what_is_drawn_has_the_sizes_that_were_asked_for():
    drawn = chance(4000, 2)
    assert drawn.position.shape == drawn.velocity.shape == drawn.force.shape == (4000, T, 2)
    assert drawn.position.std() == pytest.approx(0.02, rel=0.01)
    assert_close(drawn.velocity[:, 1:], drawn.position.diff(dim=-2) / DT)
    assert drawn.velocity.std() == pytest.approx(0.02 * np.sqrt(2) / DT, rel=0.01)
    strength = drawn.force.abs().amax(-2)
    assert strength.square().mean().sqrt() == pytest.approx(3.0, rel=0.03)
    lasts = (drawn.force != 0).all(-1).sum(-1)
    assert lasts.max() == round(0.5 / DT) and lasts.min() >= 1  # shorter where the motion ends before
    begins = (drawn.force != 0).all(-1).double().argmax(-1)
    assert torch.bincount(begins, minlength=T).min() > 4000 / T / 2  # at any time
    assert ((chance(50, 2, duration=0.1 * DT).force != 0).all(-1).sum(-1) == 1).all()


def test_a_mass_is_controlled_by_what_is_measured(random_policy, randn):
    """Both forms of Eq. 33, step by step in numpy; the implicit one solved for the acceleration."""
    policy, x0, drawn = random_policy(3, 2, 2, 0), 0.3 * randn(2), chance(2)
    reference = rollout(policy, x0, T, DT)
    xr, vr = reference.x.numpy(), np.concatenate([np.zeros((1, 2)), reference.v.numpy()])
    m, d, s = 1.3, 0.7, 30.0
    D = 2 * np.sqrt(s * m)
    for form in ("implicit", "explicit"):
        plant = ImpedanceControlled(PointMass(m, d), stiffness=s, form=form, disturbance=drawn)
        path = rollout(policy, x0, T, DT, plant=plant, backend="eager")
        x, v = x0.numpy(), np.zeros(2)
        for t in range(T):
            wrong, slip, push = (e[t].numpy() for e in drawn)
            if form == "explicit":
                a = (s * (xr[t + 1] - x - wrong) + D * (vr[t + 1] - v - slip) + push - d * v) / m
            else:  # u sees the state x + v' dt, v' = v + a dt that it leads to, with the errors of this step
                spring, damper = s * (xr[t] - x - wrong), D * (vr[t] - slip)
                v_next = (m * v / DT + spring + damper + push - d * v) / (m / DT + D + s * DT)
                a = (v_next - v) / DT
            v = v + a * DT
            x = x + v * DT
            np.testing.assert_allclose(path.x[t + 1], x, rtol=1e-10, atol=1e-12)


@needs_numba
@pytest.mark.parametrize("form", ["implicit", "explicit"])
@pytest.mark.parametrize("points", [(), (3,)])
def test_fused_roll_outs_see_the_same(random_policy, randn, form, points):
    policy = random_policy(3, 2, 2, 1, batch=(5,))
    drawn = chance(5, *points, 2)
    plant = ImpedanceControlled(PointMass(1.3, 0.7), form=form, low=0.2, high=40.0, disturbance=drawn)
    path = both(policy, 0.3 * randn(*points, 2), T, DT, plant=plant)
    still = rollout(policy, 0.3 * randn(*points, 2), T, DT, plant=ImpedanceControlled(PointMass(), low=0.2))
    assert not torch.allclose(path.x, still.x)
    both(policy, 0.3 * randn(*points, 2), T + 5, DT, plant=plant)  # none is left for the last steps


@pytest.mark.slow
@pytest.mark.no_cover
def test_a_program_that_is_traced_sees_the_same(random_policy, randn):
    policy, x0 = random_policy(3, 2, 2, 1), 0.3 * randn(2)
    plant = ImpedanceControlled(PointMass(), low=0.2, high=40.0, disturbance=chance(2))
    paths = [rollout(policy, x0, T + 5, DT, plant=plant, backend=backend) for backend in ("scan", "eager")]
    close(*paths)


@pytest.mark.parametrize("controlled", [ImpedanceControlled, PassiveControlled])
def test_a_policy_with_feedback_sees_what_is_measured(random_policy, randn, controlled):
    policy, drawn = random_policy(3, 2, 2, 2), chance(2, push=0.0)
    path = rollout(policy, 0.3 * randn(2), T, DT, plant=controlled(PointMass(), disturbance=drawn), feedback=True)
    assert_close(path.inputs, path.plant.x[:-1] + drawn.position)


def test_the_damper_of_the_passive_controller_takes_what_it_measures(random_policy, randn):
    """An error of the velocity is a force −D n, in one step from rest with a field along the first axis."""
    drawn = chance(2, push=0.0)
    policy = random_policy(1, 2, 2, 0)
    policy.A.zero_()
    policy.b.copy_(torch.tensor([[1.0, 0.0]]))
    plant = PassiveControlled(PointMass(1.0, 0.0), along=8.0, across=2.0, disturbance=drawn)
    path = rollout(policy, torch.zeros(2), 1, DT, plant=plant, feedback=True)
    D = torch.tensor([8.0, 2.0], dtype=torch.float64)
    force = torch.tensor([8.0, 0.0], dtype=torch.float64) - D * drawn.velocity[0]
    assert_close(path.plant.v[1], DT * force / (1 + DT * D))


def test_sensor_noise_is_no_force(random_policy):
    plant = PassiveControlled(PointMass(), disturbance=chance(2, push=0.0))
    assert not rollout(random_policy(3, 2, 2, 0), torch.ones(2), T, DT, plant=plant).plant.force.any()


@pytest.mark.parametrize("controlled", [ImpedanceControlled, PassiveControlled])
@pytest.mark.parametrize("backend", ["eager", "auto"])
def test_disturbances_are_of_the_roll_outs_and_in_their_precision(random_policy, controlled, backend):
    policy, x0 = random_policy(3, 2, 2, 2).float(), torch.zeros(3, 2)
    path = rollout(policy, x0, T, DT, plant=controlled(PointMass(), disturbance=chance(3, 2)), backend=backend)
    assert path.x.dtype == path.plant.force.dtype == torch.float32
    plant = controlled(PointMass(), disturbance=chance(5, 2))
    with pytest.raises(
        InvalidArgumentError, match=r"disturbance of a step has to be .* fit \(3, 2\), got shape \(5, 2\)"
    ):
        rollout(policy, x0, T, DT, plant=plant, backend=backend)


@pytest.mark.parametrize("wrong", [{"sensor": -1.0}, {"push": float("nan")}, {"duration": 0.0}])
def test_sizes_that_are_none_are_refused(wrong):
    with pytest.raises(InvalidArgumentError, match=f"{next(iter(wrong))} has to be"):
        chance(2, **wrong)
