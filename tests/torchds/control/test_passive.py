"""The passive law in the loop: the plant's own law, no energy from the damper, and a tank that never owes."""

import numpy as np
import pytest
import torch

import torchds
from torchds.control import PassiveLaw
from torchds.control.tick import ring
from torchds.errors import InvalidArgumentError


def ticked(f):
    (tick,) = ring(1, len(f), len(f), 0)
    tick._v[:] = f
    return tick


@pytest.mark.slow
def test_it_is_the_equation_and_the_damper_takes_energy_in_ten_thousand_states():
    rng, law, tick = np.random.default_rng(0), PassiveLaw(0.001, 30.0, 4.0), ticked(np.ones(3))
    f, v, forces = rng.normal(size=(10_000, 3)), rng.normal(size=(10_000, 3)), np.empty((10_000, 3))
    for i in range(len(f)):
        tick._v[:] = f[i]
        forces[i] = law(tick, v[i])
    e, wrong = f / np.linalg.norm(f, axis=1, keepdims=True), v - f
    expected = -4.0 * wrong - 26.0 * e * (e * wrong).sum(1, keepdims=True)
    np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)
    assert (v * (forces - 30.0 * f)).sum(1).max() <= 0
    np.testing.assert_allclose(law(ticked(np.zeros(3)), [1.0, 2.0, 3.0]), [-4.0, -8.0, -12.0])


@pytest.mark.slow
def test_in_a_loop_it_moves_as_the_plant_does(random_policy):
    policy, dt = random_policy(), 1e-3
    plant = torchds.passive.PassiveControlled(torchds.plants.PointMass(1.0, 0.0), 30.0, 4.0)
    with torch.no_grad():
        path = torchds.rollout(policy, [0.5, 0.2], 300, dt, plant=plant, feedback=True)
    controller, law = torchds.Controller(policy, dt, feedback=True), PassiveLaw(dt, 30.0, 4.0)
    x, v = np.array([0.5, 0.2]), np.zeros(2)
    controller.reset(x)
    for _ in range(300):
        v = v + dt * law(controller.step(x), v)
        x = x + dt * v
    np.testing.assert_allclose(x, path.x[-1].numpy(), rtol=0, atol=1e-2)


def test_a_tank_never_owes_and_an_empty_one_only_damps():
    rng, law = np.random.default_rng(1), PassiveLaw(0.01, 20.0, 5.0, tank=0.3, capacity=0.5)
    driven = []
    for f, v in zip(rng.normal(size=(500, 2)), rng.normal(size=(500, 2)), strict=True):
        before = law.tank
        force = law(ticked(f), v).copy()
        given = 0.01 * (force @ v)
        assert 0 <= law.tank <= 0.5 and law.tank - before <= -given + 1e-12  # what it gives comes from the tank
        driven.append(np.allclose(force, PassiveLaw(0.01, 20.0, 5.0)(ticked(f), v)))
    assert any(driven) and not all(driven)
    assert PassiveLaw(0.01, 20.0, tank=0.0)(ticked([1.0, 0.0]), [0.1, 0.0]).tolist() == [-2.0, 0.0]


@pytest.mark.parametrize("v", [[1.0], [np.nan, 0.0], 3.0])
def test_a_velocity_that_is_none_is_refused(v):
    with pytest.raises(InvalidArgumentError, match="v has to be the measured velocity of 2 finite numbers"):
        PassiveLaw(0.01, 1.0)(ticked([1.0, 0.0]), v)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"along": -1.0}, "along has to be finite and at least 0"),
        ({"along": 1.0, "across": np.inf}, "across has to be finite"),
        ({"along": 1.0, "tank": 2.0, "capacity": 1.0}, "tank has to be between 0 and capacity=1.0, got 2.0"),
    ],
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(InvalidArgumentError, match=words):
        PassiveLaw(0.01, **options)
