"""Point masses and the commands they get, against closed forms; roll-outs that carry a plant."""

import re
from typing import NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchds import Bounds, GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.forces import ConstantForce, SpringForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import Command, PointMass, PointMassState


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


def test_a_point_mass_begins_at_rest():
    state = PointMass().reset(tensor([1.0, 2.0], [3.0, 4.0]))
    assert state.x.tolist() == [[1, 2], [3, 4]]
    assert not any(value.any() for value in (state.v, state.acceleration, state.stiffness, state.force))
    assert {value.shape for value in state} == {(2, 2)}


def test_the_velocity_is_advanced_first_and_the_position_with_the_new_one():
    state = PointMassState(tensor(1.0), tensor(2.0), tensor(0.0), tensor(0.0), tensor(0.0))
    x, v = PointMass().advance(state, tensor(3.0), 0.5)
    assert v.tolist() == [3.5]
    assert x.tolist() == [1.0 + 3.5 * 0.5]


def test_a_force_sees_time_position_and_velocity_before_the_step(random_policy, randn):
    seen = []

    def force(t, x, v):
        seen.append((t, x, v))
        return x.flip(-1)

    path = rollout(
        random_policy(), randn(3, 2), n_steps=4, dt=0.1, plant=ImpedanceControlled(PointMass(force=force), 5.0)
    )
    assert [t for t, _, _ in seen] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    for t in range(4):
        assert torch.equal(seen[t][1], path.plant.x[:, t])
        assert torch.equal(seen[t][2], path.plant.v[:, t])
        assert torch.equal(path.plant.force[:, t + 1], path.plant.x[:, t].flip(-1))


def test_a_constant_force_may_be_one_vector_for_all(random_policy, randn):
    policy, x0, gravity = random_policy(batch=(2,)), randn(3, 2), tensor(0.0, 10.0)
    forces = (lambda t, x, v: gravity, lambda t, x, v: gravity.expand_as(x))
    one, each = (
        rollout(policy, x0, n_steps=4, dt=0.1, plant=ImpedanceControlled(PointMass(force=f), 5.0)) for f in forces
    )
    assert torch.equal(one.x, each.x)
    assert one.plant.force.shape == (2, 3, 5, 2)
    assert torch.equal(one.plant.force[..., 1:, :], gravity.expand(2, 3, 4, 2))


@pytest.mark.parametrize("backend", ["eager", "auto"])
@pytest.mark.parametrize("shape", [(5, 2), (3, 4, 2), (3,)])
@pytest.mark.parametrize("kind", [ConstantForce, lambda at: SpringForce(at, 1.0), lambda at: lambda t, x, v: at])
def test_a_force_of_other_roll_outs_is_refused_in_words(random_policy, kind, shape, backend):
    policy = random_policy(Q=1, batch=(4,)).requires_grad_(False)
    plant = ImpedanceControlled(PointMass(force=kind(torch.ones(*shape, dtype=torch.float64))))
    with pytest.raises(InvalidArgumentError, match=rf"(force|anchor) has to .*got shape {re.escape(str(shape))}"):
        rollout(policy, torch.zeros(2), 3, 0.1, plant=plant, backend=backend)


@pytest.mark.parametrize(("mass", "damping"), [(1.0, 1.0), (2.5, 0.4)])
@pytest.mark.slow
def test_a_free_mass_under_a_constant_force_approaches_its_terminal_velocity(random_policy, mass, damping):
    """Without stiffness: v' = (f − d v)/m, hence v = f/d (1 − exp(−d t/m)), up to the error of Euler's method."""
    plant = ImpedanceControlled(PointMass(mass, damping, lambda t, x, v: tensor(0.0, 3.0)), 0.0)
    path = rollout(random_policy(), tensor(0.0, 0.0), n_steps=500, dt=4e-3, plant=plant)
    t = 4e-3 * np.arange(501)
    expected = 3.0 / damping * (1 - np.exp(-damping * t / mass))
    np.testing.assert_allclose(path.plant.v[:, 1].detach(), expected, atol=4e-3 * 3.0 / damping)
    assert not path.plant.v[:, 0].any()


@pytest.mark.parametrize(
    ("mass", "damping"), [(0.0, 1.0), (-1.0, 1.0), (float("nan"), 1.0), (1.0, -0.1), (1.0, float("nan"))]
)
def test_masses_and_dampings_that_do_not_exist_are_refused(mass, damping):
    with pytest.raises(
        InvalidArgumentError, match=f"mass has to be positive and damping ≥ 0, got {mass} and {damping}"
    ):
        PointMass(mass, damping)


# ---------------------------------------------------------------------- plants of one's own, in a roll-out


class Seen(NamedTuple):
    x: Tensor
    v: Tensor
    count: Tensor
    matrix: Tensor


class Recorder:
    """A plant that jumps to beside where it is sent, has fields of its own, and keeps all commands."""

    def __init__(self):
        self.commands: list[Command] = []

    def reset(self, x0):
        return Seen(x0, torch.zeros_like(x0), torch.zeros(x0.shape[:-1]), torch.zeros(*x0.shape, 3))

    def step(self, state, command):
        self.commands.append(command)
        return Seen(command.x + 100.0, command.v[..., : command.x.shape[-1]], state.count + 1, state.matrix + 2)


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("points", [(), (4,), (2, 2)])
@pytest.mark.parametrize(("O", "Q"), [(2, 0), (3, 1), (2, 2)])
def test_a_plant_is_commanded_with_both_ends_of_every_step(random_policy, randn, batch, points, O, Q):
    policy, plant = random_policy(O=O, Q=Q, batch=batch), Recorder()
    path = rollout(policy, randn(*points, 2), n_steps=5, dt=0.2, plant=plant)
    bare = rollout(policy, path.reference[(0,) * len(batch)][..., 0, :], n_steps=5, dt=0.2, backend="eager")
    assert len(plant.commands) == 5
    for t, command in enumerate(plant.commands):
        assert (command.t, command.dt) == (pytest.approx(0.2 * t), 0.2)
        assert torch.equal(command.x_before, bare.x[..., t, :])
        assert torch.equal(command.x, bare.x[..., t + 1, :])
        assert torch.equal(command.v, bare.v[..., t, :])
        assert torch.equal(command.v_before, bare.v[..., t - 1, :] if t else torch.zeros_like(bare.v[..., 0, :]))
        if Q:
            assert_close(command.stiffness, policy.stiffness(bare.x)[..., t, :], rtol=1e-12, atol=1e-12)
        else:
            assert command.stiffness is None


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("points", [(), (4,), (2, 2)])
@pytest.mark.parametrize("Q", [0, 1])
def test_a_roll_out_has_the_plant_s_states_beside_the_reference(random_policy, randn, batch, points, Q):
    policy, x0 = random_policy(Q=Q, batch=batch), randn(*points, 2)
    path = rollout(policy, x0, n_steps=5, dt=0.2, plant=Recorder())
    bare = rollout(policy, x0, n_steps=5, dt=0.2, backend="eager")
    lead = (*batch, *points)
    assert torch.equal(path.reference, bare.x)  # the policy never sees the plant
    assert torch.equal(path.features, bare.features)
    assert path.x.shape == path.reference.shape == (*lead, 6, 2)
    assert path.v.shape == (*lead, 5, 2)
    assert torch.equal(path.x, path.plant.x)
    assert torch.equal(path.v, path.plant.v[..., 1:, :])
    assert torch.equal(path.x[..., 1:, :], bare.x[..., 1:, :] + 100.0)
    assert path.plant.count.shape == (*lead, 6)
    assert torch.equal(path.plant.count, torch.arange(6.0).expand(*lead, 6))
    assert torch.equal(path.plant.matrix, 2 * torch.arange(6.0)[:, None, None].expand(*lead, 6, 2, 3))
    assert bare.plant is None
    assert bare.reference is bare.x
    assert (path.stiffness is None) == (bare.stiffness is None) == (Q == 0)
    if Q:
        assert path.stiffness.shape == (*lead, 5, 1)
        assert_close(path.stiffness, policy.stiffness(bare.x[..., :-1, :]), rtol=1e-12, atol=1e-12)
        assert torch.equal(path.stiffness, bare.stiffness)


def test_a_plant_goes_on_where_its_reference_rests():
    one = torch.ones(1, dtype=torch.float64)
    policy = GMRPolicy(one, 0 * one[None], one[None, None], 0 * one[None, None], one[None])  # ẋ = 1
    plant = ImpedanceControlled(PointMass(), 20.0)
    path = rollout(policy, tensor(0.0), n_steps=80, dt=0.1, stop=Bounds(-1.0, 1.05), plant=plant)
    assert path.reference[10:, 0].tolist() == pytest.approx([1.0] * 71)
    assert path.stopped
    assert path.plant.v[11].abs() > 0.1
    assert path.x[-1].item() == pytest.approx(1.0, abs=1e-3)
