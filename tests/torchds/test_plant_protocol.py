"""Plants that the library does not know: that of docs/plants.md, one simulated outside torch, one with more axes."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchds import costs, rollout
from torchds.exploration import Homogeneous
from torchds.optim import PIBB, InverseIteration

PAGE = Path(__file__).parents[2] / "docs" / "plants.md"


@pytest.fixture(scope="module")
def page():
    """The names that the page's example leaves behind."""
    block = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0]
    names = {"__name__": "page"}
    exec(compile(block, str(PAGE), "exec"), names)
    return names


@pytest.mark.slow
def test_the_example_of_the_page_learns(page):
    assert len(page["costs"]) == 15
    assert page["costs"][-1] < 0.3 * page["costs"][0]
    with torch.no_grad():
        assert page["closure"]() < page["costs"][0]


def test_the_drive_of_the_page_is_its_own_loop_in_numpy(page, random_policy, randn):
    policy, x0 = random_policy(batch=(2,)), randn(3, 2)
    with torch.no_grad():
        path = rollout(policy, x0, n_steps=12, dt=0.1, plant=page["Drive"](delay=3, lag=0.5))
    assert path.plant.pending.shape == (2, 3, 13, 3, 2)
    for i in np.ndindex(2, 3):
        reference = path.reference[i].numpy()
        x = reference[0]
        for t in range(12):
            v = (reference[max(t + 1 - 3, 0)] - x) / 0.5
            x = x + 0.1 * v
            np.testing.assert_allclose(path.x[(*i, t + 1)], x, rtol=1e-12, atol=1e-13)
            np.testing.assert_allclose(path.v[(*i, t)], v, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_derivatives_flow_through_a_plant_that_stays_in_torch(page, random_policy, randn):
    plant, policy = page["Drive"](delay=2, lag=0.5), random_policy()
    torch.autograd.gradcheck(lambda x0: rollout(policy, x0, 6, 0.1, plant=plant).x, (randn(2, 2).requires_grad_(),))


# ---------------------------------------------------------------------- a simulator outside torch


class State(NamedTuple):
    x: Tensor
    v: Tensor
    effort: Tensor  # (*batch, *points), no axis of its own


class Pendulums:
    """Masses on springs, one at a time, in floats; keeps how many it had to simulate at once."""

    def __init__(self):
        self.sizes = []

    def reset(self, x0):
        return State(x0, torch.zeros_like(x0), x0.new_zeros(x0.shape[:-1]))

    def step(self, state, command):
        shape, dt = command.x.shape, command.dt
        x, v, target, effort = (
            value.detach().numpy().reshape(-1, width).copy()
            for value, width in ((state.x, 2), (state.v, 2), (command.x, 2), (state.effort, 1))
        )
        self.sizes.append(len(x))
        for i in range(len(x)):
            for d in range(2):
                u = 8.0 * (target[i, d] - x[i, d]) - 4.0 * v[i, d]
                v[i, d] += u * dt
                x[i, d] += v[i, d] * dt
                effort[i, 0] += u * u * dt
        return State(
            *(torch.from_numpy(value.reshape(s)) for value, s in ((x, shape), (v, shape), (effort, shape[:-1])))
        )


def test_a_simulator_outside_torch_gets_the_whole_batch_at_once(random_policy, randn):
    plant, policy, x0 = Pendulums(), random_policy(batch=(3, 2)), randn(4, 2)
    path = rollout(policy, x0, n_steps=5, dt=0.1, plant=plant)
    assert plant.sizes == [24] * 5
    assert path.x.shape == (3, 2, 4, 6, 2)
    assert path.plant.effort.shape == (3, 2, 4, 6)
    assert not path.x.requires_grad
    alone = rollout(policy[2, 1], x0[3], n_steps=5, dt=0.1, plant=Pendulums())
    assert_close(path.x[2, 1, 3], alone.x, rtol=1e-10, atol=1e-12)
    assert_close(path.plant.effort[2, 1, 3], alone.plant.effort, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_policy_search_learns_on_a_simulator_outside_torch(random_policy):
    """Three runs, with a cost of the plant's own and the control cost of the policy's."""
    policy, x0 = random_policy(batch=(3,)), torch.tensor([-1.0, 0.5], dtype=torch.float64)
    plant, target = Pendulums(), torch.tensor([0.6, -0.4], dtype=torch.float64)

    def cost():
        path = rollout(policy, x0, n_steps=20, dt=0.1, plant=plant)
        return costs.goal(path.x, target) + 1e-3 * path.plant.effort[..., -1]

    optim = PIBB(policy.parameters(), Homogeneous(policy, 0.3), n_rollouts=8, control_weight=1e-4)
    decay = torch.optim.lr_scheduler.LambdaLR(optim, InverseIteration())
    with torch.no_grad():
        before = cost()
    for _ in range(15):
        optim.step(cost)
        decay.step()
    with torch.no_grad():
        after = cost()
    assert plant.sizes.count(8 * 3) == 15 * 20
    assert before.shape == after.shape == (3,)
    assert (after < 0.5 * before).all()


# ---------------------------------------------------------------------- more axes than inputs


class Turning:
    """Follows exactly, and turns by the third velocity of the policy, which moves no input."""

    def reset(self, x0):
        pose = torch.cat([x0, torch.zeros_like(x0[..., :1])], -1)
        return State(pose, torch.zeros_like(pose), x0.new_zeros(x0.shape[:-1]))

    def step(self, state, command):
        return State(state.x + command.v * command.dt, command.v, state.effort)


def test_a_plant_may_have_more_axes_than_the_policy_has_inputs(random_policy, randn):
    policy, x0 = random_policy(O=3, batch=(2,)), randn(4, 2)
    path = rollout(policy, x0, n_steps=7, dt=0.2, plant=Turning())
    bare = rollout(policy, x0, n_steps=7, dt=0.2, backend="eager")
    assert path.x.shape == (2, 4, 8, 3)
    assert path.reference.shape == (2, 4, 8, 2)
    assert_close(path.x[..., :2], bare.x, rtol=1e-12, atol=1e-12)
    assert_close(path.x[..., 1:, 2], 0.2 * bare.v[..., 2].cumsum(-1), rtol=1e-12, atol=1e-12)
    assert torch.equal(path.v, bare.v)
