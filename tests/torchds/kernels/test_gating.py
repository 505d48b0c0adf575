"""The gating in compiled loops, seen through roll-outs."""

import torch

from tests.torchds.kernels.comparison import both, needs_numba
from torchds import GMRPolicy

pytestmark = needs_numba


def test_a_gating_of_its_own_for_each_policy(random_mixture, randn):
    policy = GMRPolicy.from_mixture(random_mixture(3, 4, batch=(5,)), 2)
    both(policy, randn(4, 2))
    tried = policy.pack().detach()
    policy.unpack(tried + 0.1 * randn(3, *tried.shape))  # batch (3, 5), the gating's (5,)
    both(policy, randn(2))
    both(policy, randn(3, 5, 2), starts="per_policy")


def test_far_away_and_nowhere_the_gating_is_what_it_is_in_eager(random_policy, randn):
    policy = random_policy(4)
    for size in (1e3, 1e80, 1e160, 1e300):
        both(policy, size * randn(6, 2), n_steps=1)
    x0 = torch.tensor([[torch.inf, 0.0], [0.0, -torch.inf], [torch.nan, 1.0], [1.0, 2.0]], dtype=torch.float64)
    both(policy, x0, n_steps=5)
