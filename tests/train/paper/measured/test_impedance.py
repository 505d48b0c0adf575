"""What is measured of motion and stiffness, against loops and the printed equations."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass
from train.paper.measured import impedance


@pytest.mark.slow
def test_overshoot_and_settling_are_those_of_the_printed_equations():
    s, m, dt = 30.0, 1.0, 0.1
    D = 2 * np.sqrt(s * m)
    state, highest = np.zeros(2), 0.0
    for _ in range(impedance.STEPS):
        # x' = x + v' dt, v' = v + (s (1 − x') − D v') dt / m
        matrix = np.array([[1.0, -dt], [s * dt / m, 1 + D * dt / m]])
        state = np.linalg.solve(matrix, state + np.array([0.0, s * dt / m]))
        highest = max(highest, state[0])

    def response(s, dt, **form):
        stiffness = torch.tensor([[s]], dtype=torch.float64)
        return impedance.step_response(ImpedanceControlled(PointMass(m, 0.0), **form), stiffness, dt)

    assert float(impedance.overshoot(response(s, dt))) == pytest.approx(highest - 1, abs=1e-12)
    away = response(1000.0, dt, form="explicit")
    assert float(impedance.overshoot(away)) == np.inf
    assert float(impedance.settling(away, dt)) == pytest.approx(dt * impedance.STEPS)  # never
    z = impedance.CRITICAL  # with small steps it is the closed form
    assert (1 + z) * np.exp(-z) == pytest.approx(impedance.SETTLED, rel=1e-4)
    assert float(impedance.settling(response(400.0, 1e-3), 1e-3)) == pytest.approx(z / 20, rel=0.01)


def test_stiffness_by_half_is_that_of_loops(randn):
    s, at = randn(3, 2, 7, 2).abs(), randn(3, 2, 7, 2) - 5
    inside, outside = impedance.stiffness_by_half(SimpleNamespace(plant=SimpleNamespace(stiffness=s, x=at)))
    for run, d in itertools.product(range(3), range(2)):
        halves = {True: [], False: []}
        for e, t in itertools.product(range(2), range(1, 7)):
            halves[bool(at[run, e, t, 0] > -5)].append(float(s[run, e, t, d]))
        assert float(inside[run, d]) == pytest.approx(np.mean(halves[True]))
        assert float(outside[run, d]) == pytest.approx(np.mean(halves[False]))


def test_how_far_the_force_pushes_is_measured_at_one_time(randn):
    x = randn(3, 2, 7, 2)
    found = impedance.pushed(SimpleNamespace(x=x))
    for run in range(3):
        gaps = [float((x[run, 1, t] - x[run, 0, t]).norm()) for t in range(7)]
        assert float(found[run]) == pytest.approx(max(gaps))


@pytest.mark.slow
def test_the_reference_lies_off_the_nominal_path_and_the_point_mass_farther():
    task, path = impedance.before_learning("divergent_field")
    nominal = task.nominal()
    reference, actual = (impedance.off_nominal(task, x) for x in (path.reference, path.x))
    assert reference.shape == actual.shape == (len(path.x) - 1,)
    t = int(actual.argmax())
    assert float(actual[t]) == pytest.approx(min(float((path.x[t + 1] - p).norm()) for p in nominal))
    assert 0 < reference.max() < actual.max()
    assert impedance.off_nominal(task, nominal).max() == 0
    assert impedance.via_points(task).shape[-1] == 2
