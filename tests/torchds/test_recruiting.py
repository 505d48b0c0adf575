"""Recruited Gaussians: the same field before learning, freedom near the place afterwards."""

import pytest
import torch

import torchds
from torchds.errors import InvalidArgumentError


def points(policy, randn, n=200):
    """States in and around the Gaussians, some of them far away."""
    return 5 * randn(*policy.batch_shape, n, policy.input_dim)


@pytest.mark.parametrize("kind", [{}, {"batch": (3,)}, {"batch": (4, 3), "Q": 2}, {"D": 3, "O": 3, "moved": True}])
def test_the_field_is_the_old_one(random_policy, randn, kind):
    policy = random_policy(**kind)
    x = points(policy, randn)
    at = randn(*policy.batch_shape[-1:], policy.input_dim)  # a place for each, or for the last axis of the batch
    new = torchds.recruit(policy, at, 0.8)
    torch.testing.assert_close(new(x), policy(x), atol=1e-9, rtol=1e-9)
    again = torchds.recruit(new, -at, 0.5)
    torch.testing.assert_close(again(x), policy(x), atol=1e-9, rtol=1e-9)
    if policy.stiffness_dim:
        torch.testing.assert_close(new.stiffness(x), policy.stiffness(x), atol=1e-9, rtol=1e-9)


def test_copies_have_the_share_of_a_bump(random_policy, randn):
    policy = random_policy(batch=(3,))
    x, at = points(policy, randn), randn(3, 2)
    odds = 9 * torch.exp(-0.5 * (x - at.unsqueeze(1)).square().sum(-1, keepdim=True) / 0.8**2)
    share = torchds.recruit(policy, at, 0.8).gating(x)
    h = policy.gating(x)
    torch.testing.assert_close(share[..., 3:], h * odds / (1 + odds), atol=1e-9, rtol=1e-9)
    torch.testing.assert_close(share[..., :3], h / (1 + odds), atol=1e-9, rtol=1e-9)


def test_copies_change_the_field_near_the_place_alone(random_policy):
    policy = random_policy()
    at = torch.tensor([0.5, 0.2], dtype=torch.float64)
    new = torchds.recruit(policy, at, 0.3)
    with torch.no_grad():
        new.b[3:] += 1.0
    here, there = at, at + torch.tensor([3.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(new(here) - policy(here), torch.full((2,), 0.9, dtype=torch.float64), atol=1e-9, rtol=0)
    torch.testing.assert_close(new(there), policy(there), atol=1e-12, rtol=0)


def test_a_stable_policy_stays_stable_by_the_same_margin(randn):
    goal = randn(2)
    raw = randn(2, 2, 2)
    A = -(raw @ raw.mT) - 0.1 * torch.eye(2, dtype=torch.float64)
    b = -(A @ goal)
    priors = torch.full((2,), 0.5, dtype=torch.float64)
    policy = torchds.GMRPolicy(priors, randn(2, 2), torch.eye(2, dtype=torch.float64).expand(2, 2, 2), A, b)
    before, after = (p.certificate(goal) for p in (policy, torchds.recruit(policy, randn(2), 0.5)))
    assert before.margin > 0 and before.stable and after.stable
    assert torch.equal(after.eigenvalues, before.eigenvalues.repeat(2))
    assert torch.equal(after.offset, before.offset.repeat(2))


def test_the_control_cost_is_measured_from_the_demonstrated_policy(random_policy):
    policy = random_policy(batch=(3,))
    new = torchds.recruit(policy, torch.zeros(2, dtype=torch.float64), 0.5)
    deviation = policy.rows() - policy.initial_rows
    assert deviation.abs().amax() > 0.1
    assert torch.equal(new.rows() - new.initial_rows, torch.cat([deviation, deviation], -1))


def test_what_is_frozen_and_known_of_a_policy_stays(random_policy):
    policy = random_policy(Q=1)
    policy.stiffness_A.requires_grad_(False)
    policy.info = policy.info._replace(goal=torch.zeros(2, dtype=torch.float64), names=("x", "y"), dt=0.1)
    new = torchds.recruit(policy, torch.zeros(2, dtype=torch.float64), 0.5)
    assert {name for name, p in new.named_parameters() if not p.requires_grad} == {"stiffness_A"}
    assert new.info == policy.info


def test_a_recruited_policy_learns_and_comes_back_from_its_state(random_policy):
    policy = torchds.recruit(random_policy(batch=(3,)), torch.zeros(3, 2, dtype=torch.float64), 0.5)
    optim = torchds.optim.PIBB(policy.parameters(), torchds.exploration.Homogeneous(policy), n_rollouts=5)
    start = torch.ones(2, dtype=torch.float64)
    assert optim.step(lambda: torchds.rollout(policy, start, 5, 0.1).x[..., -1, :].square().sum(-1)).shape == (3,)
    x = start.expand(3, 2)
    alone = torch.stack([policy[i](start) for i in range(3)])
    torch.testing.assert_close(policy(x), alone, atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("at", "width", "words"),
    [
        (torch.zeros(3), 1.0, r"at has to be finite and \(2,\).*got .* of shape \(3,\)"),
        (torch.zeros(2, 2), 1.0, "batch_shape"),
        (torch.full((2,), torch.nan), 1.0, "finite"),
        (torch.zeros(2), 0.0, "width"),
    ],
)
def test_wrong_places_and_widths_are_refused(random_policy, at, width, words):
    with pytest.raises(InvalidArgumentError, match=words):
        torchds.recruit(random_policy(batch=(3,)), at.double(), width)


def test_most_wanted_is_where_the_most_missed_via_point_is_passed(random_policy, randn):
    policy = random_policy(batch=(3,))
    path = torchds.rollout(policy, randn(2, 2), 20, 0.05)  # two starts
    via = torch.tensor([[1.0, 1.0], [-2.0, 0.5]], dtype=torch.float64)
    found = torchds.most_wanted(path, lambda path: torchds.costs.via_points(path.x, via).sum(-1))
    for run in range(3):
        far = (path.x[run, :, 1:, None] - via).norm(dim=-1).detach()  # (S, T, L)
        nearest, when = far.min(1)
        start, point = divmod(int(nearest.argmax()), len(via))
        assert torch.equal(found[run], path.x[run, start, 1 + when[start, point]].detach())
