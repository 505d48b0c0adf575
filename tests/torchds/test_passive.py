"""The passive velocity controller: the equation, the energy, and where pushed motions end."""

import pytest
import torch
from torch.testing import assert_close

import torchds
from torchds.errors import InvalidArgumentError
from torchds.passive import PassiveControlled
from torchds.plants import Command, PointMass
from torchds.testing import check_plant


def command(f, dt=0.1):
    return Command(torch.zeros_like(f), torch.zeros_like(f), f, f, None, 0.0, dt)


@pytest.fixture
def certified(randn):
    """A system of two components that ends at the origin from everywhere; a rotation is in it, so it is no gradient."""
    raw, turn = randn(2, 2, 2), torch.tensor([[0.0, -1.5], [1.5, 0.0]], dtype=torch.float64)
    A = -0.3 * raw @ raw.mT - torch.eye(2, dtype=torch.float64) + turn
    eye = torch.eye(2, dtype=torch.float64).repeat(2, 1, 1)
    policy = torchds.GMRPolicy(torch.ones(2) / 2, randn(2, 2), eye, A, torch.zeros(2, 2))
    assert policy.certificate(torch.zeros(2)).stable
    return policy


def test_a_step_is_the_implicit_equation(randn):
    plant = PassiveControlled(PointMass(2.0, 0.7, lambda t, x, v: 3 * x), along=11.0, across=5.0)
    x, v, f = randn(40, 3), randn(40, 3), randn(40, 3)
    after = plant.step(plant.reset(x)._replace(v=v), command(f))
    e = f / f.norm(dim=-1, keepdim=True)
    D = 5.0 * torch.eye(3).double() + 6.0 * e[:, :, None] * e[:, None]
    expected = ((-D @ (after.v - f)[..., None]).squeeze(-1) + 3 * x - 0.7 * after.v) / 2.0
    assert_close((after.v - v) / 0.1, expected, rtol=1e-10, atol=1e-10)  # m a = −D (v' − f) + F − d v'
    assert_close(after.x, x + 0.1 * after.v, rtol=0, atol=1e-15)


def test_the_stiffness_of_a_policy_is_the_damping_that_belongs_to_it(randn):
    v, f, s = randn(20, 2), randn(20, 2), 50 * randn(20, 2).abs()
    learned = PassiveControlled(PointMass(2.0, 0.0), None, low=10.0, high=40.0)
    after = learned.step(learned.reset(v)._replace(v=v), command(f)._replace(stiffness=s))
    assert torch.equal(after.stiffness, s.clamp(10.0, 40.0))
    for i in range(20):
        along, across = (2 * (2.0 * after.stiffness[i]).sqrt()).tolist()
        fixed = PassiveControlled(PointMass(2.0, 0.0), along, across)
        assert_close(
            after.v[i], fixed.step(fixed.reset(v[i])._replace(v=v[i]), command(f[i])).v, rtol=1e-12, atol=1e-12
        )
    with pytest.raises(InvalidArgumentError, match=r"a policy without stiffness says no damping; .*along="):
        learned.step(learned.reset(v), command(f))


def test_where_the_field_ends_the_damping_is_the_same_in_all_directions(randn):
    plant, v = PassiveControlled(PointMass(1.0, 0.0), along=50.0, across=5.0), randn(20, 2)
    after = plant.step(plant.reset(torch.zeros(20, 2).double())._replace(v=v), command(torch.zeros(20, 2).double()))
    assert_close(after.v, v / (1 + 0.1 * 5.0), rtol=1e-12, atol=0)


@pytest.mark.parametrize("dt", [1e-3, 0.1, 10.0])
def test_the_damper_generates_no_energy_in_ten_thousand_pushes(randn, dt):
    """½ m v² rises by no more than the force and the drive put in."""
    n = 10_000
    x, v, f, push = randn(n, 2), 3 * randn(n, 2), randn(n, 2), 10 * randn(n, 2)
    plant = PassiveControlled(PointMass(1.3, 0.0, lambda t, x, v: push), along=30.0, across=4.0)
    after = plant.step(plant.reset(x)._replace(v=v), command(f, dt))
    risen = 0.65 * (after.v.square() - v.square()).sum(-1)
    given = dt * ((push + 30.0 * f) * after.v).sum(-1)
    assert float((risen - given).max()) <= 1e-9


@pytest.mark.slow
def test_with_a_tank_kinetic_energy_and_tank_rise_by_no_more_than_the_force_puts_in(certified, randn):
    pushes = 4 * randn(500, 200, 2)
    plant = PassiveControlled(
        PointMass(1.0, 0.0, lambda t, x, v: pushes[:, round(t / 0.05)]), along=20.0, tank=0.5, capacity=2.0
    )
    with torch.no_grad():
        path = torchds.rollout(certified, randn(500, 2), 200, 0.05, plant=plant, feedback=True)
    total = 0.5 * path.plant.v.square().sum(-1) + path.plant.tank.squeeze(-1)
    given = 0.05 * (pushes * path.v).sum(-1)
    assert float((total.diff(dim=-1) - given).max()) <= 1e-9
    assert float(path.plant.tank.min()) >= 0 and float(path.plant.tank.max()) <= 2.0


@pytest.mark.slow
def test_an_empty_tank_gives_no_drive_and_a_full_one_changes_nothing(certified):
    x0, point = torch.ones(2).double(), PointMass(1.0, 0.0)
    with torch.no_grad():
        empty, full, none = (
            torchds.rollout(certified, x0, 100, 0.05, plant=PassiveControlled(point, tank=tank), feedback=True)
            for tank in (0.0, 1e3, None)
        )
    assert torch.equal(empty.x, x0.expand(101, 2)) and torch.equal(full.x, none.x)


@pytest.mark.parametrize("plant", ["passive", "impedance"])
@pytest.mark.slow
def test_in_closed_loop_a_certified_motion_ends_at_its_goal_from_anywhere_after_a_push(certified, randn, plant):
    x0 = 5 * randn(100, 2)

    def push(t, x, v):
        return torch.full_like(x, 30.0) * (1.0 < t < 1.3)

    paths = []
    for mass in (PointMass(1.0, 0.0, push), PointMass(1.0, 0.0)):
        impedance = torchds.impedance.ImpedanceControlled(mass, 100.0)
        tracked = PassiveControlled(mass, 40.0) if plant == "passive" else impedance
        with torch.no_grad():
            paths.append(torchds.rollout(certified, x0, 800, 0.02, plant=tracked, feedback=True).x)
    assert float(paths[0][:, -1].norm(dim=-1).max()) < 1e-4
    assert float((paths[0][:, 66] - paths[1][:, 66]).norm(dim=-1).min()) > 0.05  # it was pushed


def test_it_is_a_plant():
    check_plant(PassiveControlled(PointMass(), along=3.0, across=1.0, tank=1.0), torch.ones(2, 2).double())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"along": -1.0}, "along has to be finite and at least 0, got -1.0"),
        ({"across": float("inf")}, "across has to be finite and at least 0"),
        ({"along": None, "across": 1.0}, "across=1.0 needs along="),
        ({"low": 2.0, "high": 1.0}, "0 ≤ low ≤ high"),
        ({"tank": 2.0, "capacity": 1.0}, "tank has to be between 0 and capacity=1.0, got 2.0"),
    ],
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(InvalidArgumentError, match=words):
        PassiveControlled(PointMass(), **options)


def test_fewer_velocities_than_axes_are_refused():
    plant = PassiveControlled(PointMass())
    with pytest.raises(InvalidArgumentError, match="3 axes need as many velocities, got 2"):
        plant.step(plant.reset(torch.zeros(3)), command(torch.zeros(2)))
