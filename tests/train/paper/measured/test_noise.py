"""Velocity noise and perturbed motions, against sampling, the Rayleigh mean, and no noise at all."""

import math
from types import SimpleNamespace

import pytest
import torch

import tasks
from torchds.exploration import Gaussian, Homogeneous
from train.paper.measured import noise


def test_the_mean_norm_of_the_velocity_noise_is_that_of_samples(random_policy, randn):
    policy = random_policy(K=3)
    n = policy.pack().shape[-1]
    root = 0.3 * randn(n, n)
    x = randn(5, 2)
    G = policy.basis(x)[..., :2, :]
    sampled = (G @ (root @ randn(n, 40_000))).norm(dim=-2)  # (5, 40000)
    found = noise.velocity_noise(policy, root @ root.mT, x)
    error = sampled.std(-1) / math.sqrt(sampled.shape[-1])
    assert ((found - sampled.mean(-1)).abs() < 4.5 * error).all()


def test_with_one_variance_it_is_the_rayleigh_mean(random_policy, randn):
    policy, x = random_policy(K=3), randn(6, 2)
    h = policy.gating(x)
    features = torch.cat([h[..., None] * x[..., None, :], h[..., None]], -1).flatten(-2)
    expected = 0.7 * features.norm(dim=-1) * math.sqrt(math.pi / 2)
    covariance = 0.49 * torch.eye(policy.pack().shape[-1], dtype=torch.float64)
    torch.testing.assert_close(noise.velocity_noise(policy, covariance, x), expected, rtol=1e-9, atol=0)


def test_the_relative_noise_does_not_depend_on_the_desired_speed():
    policy, way = noise.imitated()
    slow, fast = (noise.relative_noise(policy, Homogeneous(policy, mean_speed=v), way) for v in (0.1, 2.0))
    torch.testing.assert_close(slow, fast, rtol=1e-9, atol=0)


@pytest.mark.slow
def test_motions_without_noise_are_the_policys_own_and_a_seed_says_which_they_are():
    task = tasks.make("via_point", shape="N")
    policy = task.policy()

    @torch.no_grad()
    def moved(scale, seed):
        return noise.perturbed(task, policy, Gaussian(1.0), scale, 3, seed)

    still = task.rollout(policy).x.detach()
    torch.testing.assert_close(moved(0.0, 0), still.expand(3, -1, -1), rtol=1e-12, atol=1e-12)
    assert torch.equal(moved(0.01, 1), moved(0.01, 1))
    assert not torch.equal(moved(0.01, 1), moved(0.01, 2))


@pytest.mark.parametrize(("rate", "expected"), [(-1.0, False), (0.5, True), (math.nan, True)])
@pytest.mark.slow
def test_a_field_that_pushes_away_diverges_and_one_that_pulls_does_not(rate, expected):
    task = tasks.make("via_point", shape="N")
    policy = task.policy().expand(2)
    with torch.no_grad():
        policy.A.copy_(rate * torch.eye(2, dtype=torch.float64).expand_as(policy.A))
        policy.b.copy_(-rate * task.scene().goal.expand_as(policy.b))
    found = noise.diverging(SimpleNamespace(task=task, policy=policy))
    assert found.shape == (2, noise.SIDE**2)
    assert (found == expected).double().mean() > 0.98  # a start at the goal stays there
