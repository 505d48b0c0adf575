"""Stiffness that changes along the motion: the energy this injects, its limits, derivatives and learning."""

import numpy as np
import pytest
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


def make_policy(speed=1.0, batch=()):
    """Two axes, two stiffness rows between 2 and 30 where the motion passes; `speed` 0 keeps the reference at rest."""
    policy = GMRPolicy(
        tensor(0.5, 0.5),
        tensor([-0.9, 0.6], [0.5, -0.4]),
        tensor([[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]),
        speed * tensor([[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]),
        speed * tensor([0.3, -0.4], [0.5, -0.1]),
        tensor([[6.0, -4.0], [-3.0, 8.0]], [[2.0, 5.0], [7.0, -6.0]]),
        tensor([20.0, 7.0], [8.0, 11.0]),
    )
    if batch:
        theta = policy.pack().detach()
        generator = torch.Generator().manual_seed(6)
        policy.unpack(theta + 0.1 * torch.randn(*batch, len(theta), generator=generator, dtype=torch.float64))
    return policy


# ---------------------------------------------------------------------- energy


class Scheduled:
    """A plant that begins beside its reference, with a stiffness that a function of the time gives."""

    def __init__(self, plant, offset, schedule):
        self.plant, self.offset, self.schedule = plant, offset, schedule

    def reset(self, x0):
        return self.plant.reset(x0 + self.offset)

    def step(self, state, command):
        return self.plant.step(state, command._replace(stiffness=self.schedule(command.t).expand_as(command.x)))


def square_wave(t):
    return tensor(60.0, 3.0) if int(10 * t) % 4 < 2 else tensor(2.0, 50.0)


def swinging(**options):
    """A reference at rest, a mass that swings to it from eight points around, and the energy `(8, T)` it has."""
    angle = torch.arange(8, dtype=torch.float64)
    offset = torch.stack([angle.cos(), angle.sin()], -1)
    mass = 1.7
    plant = Scheduled(ImpedanceControlled(PointMass(mass, 0.0), **options), offset, square_wave)
    with torch.no_grad():
        path = rollout(make_policy(speed=0.0), tensor(0.3, 0.2).expand(8, 2), 60, 0.05, plant=plant)
    x, v, s = path.plant.x[:, 1:], path.plant.v[:, 1:], path.plant.stiffness[:, 1:]
    assert torch.equal(path.reference, path.reference[:, :1].expand_as(path.reference))
    return path, (0.5 * mass * v.square() + 0.5 * s * (path.reference[:, 1:] - x).square()).sum(-1)


def test_energy_grows_by_no_more_than_the_changes_of_stiffness_inject():
    path, energy = swinging()
    injected = injected_energy(path)
    assert (energy - energy[:, :1] <= injected.unsqueeze(-1) + 1e-12).all()
    assert (energy.amax(-1) > 1.2 * energy[:, 0]).any()  # it does grow, but for the bound
    assert (energy.diff(dim=-1).clamp_min(0).sum(-1) > 0.5 * injected).any()  # which is not idle


@pytest.mark.slow
def test_a_limited_rate_lets_less_energy_in():
    """At most ½ rate dt Σ |e|²."""
    free, _ = swinging()
    for rate in (100.0, 20.0):
        path, energy = swinging(max_rate=rate)
        changes = path.plant.stiffness[:, 1:].diff(dim=-2).abs()
        assert changes.max() <= rate * 0.05 * (1 + 1e-12)
        injected = injected_energy(path)
        assert (energy - energy[:, :1] <= injected.unsqueeze(-1) + 1e-12).all()
        assert (injected <= 0.5 * rate * 0.05 * (path.reference - path.plant.x)[:, 1:-1].square().sum((-2, -1))).all()
        assert injected.mean() < {100.0: 0.7, 20.0: 0.2}[rate] * injected_energy(free).mean()


def one_step(plant, x, v, dt):
    """Energy of the spring and of a unit mass before and after one step towards a reference at rest in the origin."""
    zero, s = torch.zeros_like(x), plant.stiffness
    state = plant.reset(x)._replace(v=v)
    after = plant.step(state, Command(zero, zero, zero, zero, None, 0.0, dt))
    return [0.5 * (q.v.square() + s * q.x.square()).sum(-1) for q in (state, after)]


@pytest.mark.parametrize("stiffness", [4.0, 900.0])
def test_the_explicit_form_takes_energy_up_to_a_time_step_of_four_fifths_of_the_natural_one(stiffness):
    """With a = √(s/m) dt, one step is a 2×2 matrix of norm at most 1 just where a³ (4 − 5a) ≥ 0; the implicit always is."""
    angle = torch.linspace(0, np.pi, 2001, dtype=torch.float64)
    x, v = angle.cos()[:, None], angle.sin()[:, None] * stiffness**0.5
    for a, grows in ((0.01, False), (0.3, False), (0.799, False), (0.801, True), (2.0, True)):
        for form in ("explicit", "implicit"):
            plant = ImpedanceControlled(PointMass(1.0, 0.0), stiffness, form=form)
            before, after = one_step(plant, x, v, a / stiffness**0.5)
            assert ((after > before * (1 + 1e-13)).any().item()) == (grows and form == "explicit"), (form, a)


# ---------------------------------------------------------------------- limits


@FORMS
@pytest.mark.parametrize("batch", [(), (3,), (2, 2)])
@pytest.mark.slow
def test_each_roll_out_of_a_batch_has_a_limited_rate_of_its_own(randn, form, batch):
    policy, x0 = make_policy(batch=batch), randn(4, 2)
    plant = ImpedanceControlled(PointMass(), form=form, low=3.0, high=20.0, max_rate=8.0)
    path = rollout(policy, x0, 15, 0.05, plant=plant)
    for i in np.ndindex(batch):
        single = make_policy().unpack(policy.pack()[i])
        for j in range(4):
            alone = rollout(single, x0[j], 15, 0.05, plant=plant)
            assert_close(path.plant.stiffness[(*i, j)], alone.plant.stiffness, rtol=1e-11, atol=1e-11)
            assert_close(path.x[(*i, j)], alone.x, rtol=1e-11, atol=1e-12)
    changes = path.plant.stiffness[..., 1:, :].detach().diff(dim=-2).abs()
    assert changes.max() == pytest.approx(8.0 * 0.05, rel=1e-12)
    assert changes.min() < 0.9 * 8.0 * 0.05


def test_a_limited_rate_begins_at_what_the_policy_first_asks_for():
    path = rollout(make_policy(), tensor(-1.2, 0.9), 3, 0.05, plant=ImpedanceControlled(PointMass(), max_rate=1e-6))
    assert_close(path.plant.stiffness[1:], path.stiffness[:1].expand(3, 2), rtol=0, atol=1e-6)
    assert not path.plant.stiffness[0].any()  # nothing is applied before the first step


def test_three_axes_may_share_two_rows(random_policy, randn):
    policy, x0 = random_policy(D=3, O=3, Q=2), randn(5, 3)
    with torch.no_grad():
        policy.stiffness_b.add_(20.0)
    path = rollout(policy, x0, 6, 0.05, plant=ImpedanceControlled(PointMass(), rows=(1, 0, 1)))
    assert path.plant.stiffness.shape == (5, 7, 3)
    assert torch.equal(path.plant.stiffness[:, 1:], path.stiffness[..., [1, 0, 1]].clamp_min(0))
    with pytest.raises(InvalidArgumentError, match=r"2 stiffness rows cannot control 3 axes by rows=\(0, 1\)"):
        rollout(policy, x0, 6, 0.05, plant=ImpedanceControlled(PointMass()))


def test_the_clamped_share_counts_rows_as_the_policy_has_them():
    """Both axes may follow one row; the other is asked for and counts too."""
    plant = ImpedanceControlled(PointMass(), low=10.0, rows=(0, 0))
    path = rollout(make_policy(batch=(3,)), tensor([-1.2, 0.9], [0.4, 0.3]), 25, 0.05, plant=plant)
    asked = path.stiffness.detach().numpy()
    expected = [[sum(s < 10.0 for s in asked[r, i].ravel()) / 50 for i in range(2)] for r in range(3)]
    np.testing.assert_allclose(clamped_share(path, plant), expected, rtol=1e-12)
    assert 0 < np.mean(expected) < 1


# ---------------------------------------------------------------------- derivatives and learning


class Tracked(nn.Module):
    def __init__(self, policy, plant):
        super().__init__()
        self.policy, self.plant = policy, plant

    def forward(self):
        path = rollout(self.policy, tensor(-1.2, 0.9), 6, 0.1, plant=self.plant)
        return path.x, path.plant.stiffness, injected_energy(path)


@FORMS
@pytest.mark.parametrize("rows", [None, (1, 0), (0, 0)])
@pytest.mark.slow
def test_a_motion_differentiates_through_bounds_and_limits(form, rows):
    policy = make_policy()
    plant = ImpedanceControlled(PointMass(), form=form, low=9.0, high=20.0, max_rate=10.0, rows=rows)
    module = Tracked(policy, plant)
    names = [f"policy.{name}" for name, _ in policy.named_parameters()]
    applied = module()[1][1:]
    assert (applied != rollout(policy, tensor(-1.2, 0.9), 6, 0.1).stiffness).any()
    torch.autograd.gradcheck(
        lambda *values: functional_call(module, dict(zip(names, values, strict=True)), ()),
        tuple(p.detach().clone().requires_grad_() for p in policy.parameters()),
    )


@pytest.mark.slow
@FORMS
def test_gradients_find_the_stiffness_behind_a_motion(form):
    """The field pushes; how far the mass gives way says how stiff it was held."""
    plant = ImpedanceControlled(PointMass(force=lambda t, x, v: tensor(3.0, -2.0)), form=form)
    target, policy = make_policy(), make_policy()
    with torch.no_grad():
        wanted = rollout(target, tensor(-1.2, 0.9), 40, 0.05, plant=plant)
        policy.stiffness_A.zero_()
        policy.stiffness_b.fill_(12.0)
    optim = torch.optim.Adam([policy.stiffness_A, policy.stiffness_b], lr=0.5)
    losses, errors = [], []
    for _ in range(60):
        optim.zero_grad()
        path = rollout(policy, tensor(-1.2, 0.9), 40, 0.05, plant=plant)
        loss = (path.x - wanted.x).square().sum()
        loss.backward()
        optim.step()
        losses.append(loss.item())
        errors.append((path.stiffness - wanted.stiffness).abs().mean().item())
    assert losses[-1] < 0.05 * losses[0]
    assert errors[-1] < 0.5 * errors[0]
