"""Roll-outs as a GPU makes them, by Triton's interpreter, against the eager loop."""

import pytest
import torch

from tests.torchds.kernels.comparison import both, needs_numba
from tests.torchds.kernels.interpreted import interpreter  # noqa: F401
from torchds import Bounds, GMRPolicy, rollout

pytestmark = [needs_numba, pytest.mark.slow, pytest.mark.no_cover]


@pytest.mark.parametrize(
    ("K", "D", "O", "Q", "batch", "points"),
    [(1, 1, 1, 0, (), ()), (4, 2, 2, 0, (40,), ()), (3, 2, 3, 1, (3, 2), (2,)), (2, 3, 3, 3, (), (2, 2))],
)
def test_a_rollout_is_the_eager_one(random_policy, randn, K, D, O, Q, batch, points):
    policy = random_policy(K, D, O, Q, batch=batch)
    both(policy, randn(*points, D), n_steps=8, dt=0.1)
    both(policy, randn(*batch, *points, D), n_steps=3, dt=0.1, starts="per_policy")


def test_a_gating_of_its_own_for_each_policy(random_mixture, randn):
    policy = GMRPolicy.from_mixture(random_mixture(3, 4, batch=(5,)), 2)
    tried = policy.pack().detach()
    policy.unpack(tried + 0.1 * randn(3, *tried.shape))  # batch (3, 5), the gating's (5,)
    both(policy, randn(2, 2), n_steps=6)


def test_shifts(random_policy, randn):
    policy, x0 = random_policy(3, batch=(4, 2)), randn(3, 2)
    for shift in (randn(2), randn(3, 2), randn(2, 1, 2)):
        both(policy, x0, n_steps=4, shift=shift)


def test_single_precision(random_policy, randn):
    policy = random_policy(4, 2, 2, 1, batch=(6,)).float()
    path = both(policy, randn(2).float(), n_steps=20, dt=0.01, rtol=2e-5, stop=Bounds(-3.0, 3.0))
    assert path.x.dtype == torch.float32


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, which the interpreter computes with
def test_far_away_and_nowhere(random_policy, randn):
    policy = random_policy(4)
    sizes = torch.tensor([1e3, 1e80, 1e160, 1e300], dtype=torch.float64)
    for far in sizes[:, None, None] * randn(4, 6, 2):
        both(policy, far, n_steps=1)
    x0 = torch.tensor([[torch.inf, 0.0], [0.0, -torch.inf], [torch.nan, 1.0], [1.0, 2.0]], dtype=torch.float64)
    both(policy, x0, n_steps=5)
    both(policy, x0, n_steps=5, stop=Bounds(-9.0, 9.0))


def test_alone_the_numbers_are_the_same_to_the_last_bit(random_policy, randn):
    policy, x0 = random_policy(3), randn(33, 2)
    with torch.no_grad():
        all_of_them, last = (rollout(policy, x, 10, 0.1, backend="fused").x for x in (x0, x0[-1]))
    assert torch.equal(all_of_them[-1], last)
