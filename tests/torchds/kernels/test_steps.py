"""Scalar steps of a user's own."""

import math

import pytest
import torch

from tests.torchds.kernels.comparison import both, needs_numba
from torchds import Bounds
from torchds.impedance import ImpedanceControlled
from torchds.kernels import ScalarStep
from torchds.plants import PointMass, PointMassState

pytestmark = needs_numba


class Circle:
    """A stop condition with a scalar step of its own."""

    def __call__(self, x, x_next):
        return x_next.square().sum(-1) > 4.0

    def scalar_step(self, n_axes, n_rows):
        def outside(p, x, x_next):
            total = 0.0
            for d in range(len(x_next)):
                total += x_next[d] ** 2
            return total > p[0]

        return ScalarStep(outside, torch.tensor([4.0]))


class Wind:
    """A force with one."""

    def __init__(self, strength):
        self.strength = strength

    def __call__(self, t, x, v):
        return self.strength * torch.sin(x + t) - 0.1 * v

    def scalar_step(self, n_axes, n_rows):
        def push(p, t, x, v, force):
            for d in range(len(x)):
                force[d] = p[0] * math.sin(x[d] + t) - 0.1 * v[d]

        return ScalarStep(push, torch.tensor([self.strength]))


class Lag:
    """A plant with one: it closes a part of the distance in every step, and remembers how far it was."""

    def reset(self, x0):
        zero = torch.zeros_like(x0)
        return PointMassState(x0, zero, zero, zero, zero)

    def step(self, state, command):
        distance = command.x - state.x
        x = state.x + 0.3 * distance
        return type(state)(x, (x - state.x) / command.dt, distance, command.stiffness[..., [0, 0]], torch.zeros_like(x))

    def scalar_step(self, n_axes, n_rows):
        def step(p, before, after, x_before, x, v_before, v, stiffness, t, dt):
            D = len(x)
            for d in range(D):
                after[2 * D + d] = x[d] - before[d]
                after[d] = before[d] + p[0] * after[2 * D + d]
                after[D + d] = (after[d] - before[d]) / dt
                after[3 * D + d] = stiffness[0]
                after[4 * D + d] = 0.0

        return ScalarStep(step, torch.tensor([0.3], dtype=torch.float64))


@pytest.mark.slow
def test_scalar_steps_of_a_user(random_policy, randn):
    policy, x0 = random_policy(4, 2, 2, 1, batch=(6,)), 0.5 * randn(2)
    assert both(policy, x0, dt=0.1, stop=Circle()).stopped.any()
    both(policy, x0, plant=Lag(), stop=Bounds(-2.0, 2.0))
    both(policy, x0, plant=ImpedanceControlled(PointMass(force=Wind(2.0)), low=0.1), rtol=1e-11)
