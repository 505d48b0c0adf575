"""The noise of the authors' released program against its formulas in numpy."""

import numpy as np
import pytest
import scipy.stats
import torch

from tasks.released.exploration import ReleasedHomogeneous
from torchds.optim import PIBB


def draw(exploration, n):
    """The noise of all parameters by name."""
    generator = torch.Generator().manual_seed(0)
    named = dict(exploration.policy.named_parameters())
    normals = [torch.randn(n, *p.shape, dtype=p.dtype, generator=generator) for p in named.values()]
    return dict(zip(named, exploration(list(named.values()), normals), strict=True))


def released_std(policy, ratio):
    """std of the velocity rows as the authors' program has it, for one policy: numpy, one Gaussian after the other."""
    priors, means, covariances, A, b = (
        value.detach().numpy() for value in (policy.priors, policy.means, policy.covariances, policy.A, policy.b)
    )
    c = np.sqrt(2 / (3 * np.pi)) * ratio
    std_A, std_b = [], []
    for mu in means:
        density = [
            prior * scipy.stats.multivariate_normal(m, s).pdf(mu)
            for prior, m, s in zip(priors, means, covariances, strict=True)
        ]
        h = np.array(density) / sum(density)
        speed = np.linalg.norm(sum(h[k] * (A[k] @ mu + b[k]) for k in range(len(h))))  # of the whole mixture
        std_A.append([[c * speed / max(abs(mu[d]), 1.0) for d in range(2)]] * 2)
        std_b.append([c * speed] * 2)
    return np.array(std_A), np.array(std_b)


@pytest.mark.parametrize("ratio", [0.1, 0.04])
def test_the_released_noise_is_a_ratio_of_the_speed_of_the_current_policy_at_each_centre(random_policy, ratio):
    policy = random_policy(moved=True)
    assert (policy.means.abs() > 1).any()
    assert (policy.means.abs() < 1).any()
    exploration = ReleasedHomogeneous(policy, ratio)
    for _ in range(2):
        std_A, std_b = released_std(policy, ratio)
        std = exploration.std()
        np.testing.assert_allclose(std["A"], std_A, rtol=1e-11)
        np.testing.assert_allclose(std["b"], std_b, rtol=1e-11)
        assert not std["A"].requires_grad
        with torch.no_grad():  # the second time, of the policy as it is then
            policy.A.mul_(1.7)
            policy.b.add_(0.4)
    assert np.abs(released_std(policy, ratio)[1] / std_b - 1).min() > 0.01


def test_the_released_noise_follows_the_policy_while_an_optimizer_changes_it(random_policy):
    policy = random_policy()
    optim = PIBB(policy.parameters(), ReleasedHomogeneous(policy, 0.1), n_rollouts=3)
    for _ in range(3):
        before = policy.A.detach().clone()
        z = [torch.ones(3, *p.shape, dtype=torch.float64) for p in policy.parameters()]
        std_A, std_b = released_std(policy, 0.1)
        tried = optim.ask([z])
        np.testing.assert_allclose((tried[0] - before).numpy(), np.broadcast_to(std_A, tried[0].shape), rtol=1e-10)
        np.testing.assert_allclose((tried[1] - policy.b.detach())[0].numpy(), std_b, rtol=1e-10)
        optim.tell(torch.arange(3.0))


def test_the_released_noise_leaves_out_the_speed_for_stiffness_rows(random_policy):
    """std_b = 100 c and std_A = 20 c / max(|μ|, 1) with c = √(2/3π) · ratio."""
    policy, ratio = random_policy(Q=2, moved=True), 0.1
    std = ReleasedHomogeneous(policy, ratio, mean_stiffness=100 * ratio).std()
    c = np.sqrt(2 / (3 * np.pi)) * ratio
    np.testing.assert_allclose(std["stiffness_b"], np.full((3, 2), 100 * c), rtol=1e-13)
    slopes = [[[20 * c / max(abs(mu[d]), 1.0) for d in range(2)]] * 2 for mu in policy.means.numpy()]
    np.testing.assert_allclose(std["stiffness_A"], slopes, rtol=1e-13)


def test_the_released_noise_gives_every_policy_of_a_batch_its_own_noise(random_policy):
    policy = random_policy(batch=(4,))
    exploration = ReleasedHomogeneous(policy, 0.1)
    noise = draw(exploration, 5)
    assert noise["A"].shape == (5, 4, 3, 2, 2)
    std = exploration.std()
    for r in range(4):
        std_A, std_b = released_std(policy[r], 0.1)
        np.testing.assert_allclose(std["A"][r], std_A, rtol=1e-11)
        np.testing.assert_allclose(std["b"][r], std_b, rtol=1e-11)
        alone = draw(ReleasedHomogeneous(policy[r], 0.1), 1)
        assert alone["A"].shape == (1, 3, 2, 2)
