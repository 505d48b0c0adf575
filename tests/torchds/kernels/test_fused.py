"""Fused roll-outs against the eager loop, which is their definition."""

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import DT, T, both, needs_numba
from torchds import Bounds, GMRPolicy, Walls, rollout

pytestmark = needs_numba

SQUARE = torch.tensor([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]], dtype=torch.float64)
WALLS = Walls(torch.stack([SQUARE, SQUARE.roll(-1, 0)], 1))


@pytest.mark.parametrize(("K", "D", "O", "Q"), [(1, 1, 1, 0), (4, 2, 2, 0), (3, 2, 3, 1), (5, 3, 3, 3)])
@pytest.mark.parametrize(("batch", "points"), [((), ()), ((7,), ()), ((), (4,)), ((3, 2), (2, 2)), ((5,), (3,))])
def test_a_fused_rollout_is_the_eager_one(random_policy, randn, K, D, O, Q, batch, points):
    policy = random_policy(K, D, O, Q, batch=batch)
    both(policy, randn(*points, D))
    both(policy, randn(*batch, *points, D), starts="per_policy")


def test_two_hundred_steps_agree_to_twelve_digits(random_policy, randn):
    both(random_policy(4, batch=(30,)), 0.5 * randn(2), n_steps=200, dt=0.01)


def test_single_precision(random_policy, randn):
    policy = random_policy(4, 2, 2, 1, batch=(6,)).float()
    path = both(policy, randn(2).float(), dt=0.01, rtol=2e-5, stop=Bounds(-3.0, 3.0))
    assert path.x.dtype == torch.float32


def test_shifts(random_policy, randn):
    policy, x0 = random_policy(3, batch=(4, 2)), randn(3, 2)
    for shift in (randn(2), randn(3, 2), randn(4, 2, 3, 2), randn(2, 1, 2)):
        both(policy, x0, shift=shift)
    with pytest.raises(torchds.errors.InvalidArgumentError, match="has to broadcast"):
        rollout(policy, x0, T, DT, shift=randn(5, 2), backend="fused")


def test_a_gating_of_its_own_for_each_policy(random_mixture, randn):
    policy = GMRPolicy.from_mixture(random_mixture(3, 4, batch=(5,)), 2)
    both(policy, randn(4, 2))
    tried = policy.pack().detach()
    policy.unpack(tried + 0.1 * randn(3, *tried.shape))  # batch (3, 5), the gating's (5,)
    both(policy, randn(2))
    both(policy, randn(3, 5, 2), starts="per_policy")


@pytest.mark.parametrize(
    "stop", [Bounds(-1.5, 1.0), Bounds(torch.tensor([-1.0, -2.0]).double(), torch.tensor([9.0, 0.5]).double()), WALLS]
)
def test_stop_conditions(random_policy, randn, stop):
    path = both(random_policy(4, 2, 2, 1, batch=(40,)), 0.5 * randn(5, 2), dt=0.03, stop=stop)
    assert path.stopped.any() and not path.stopped.all()


def test_far_away_and_nowhere_the_gating_is_what_it_is_in_eager(random_policy, randn):
    policy = random_policy(4)
    for size in (1e3, 1e80, 1e160, 1e300):
        both(policy, size * randn(6, 2), n_steps=1)
    x0 = torch.tensor([[torch.inf, 0.0], [0.0, -torch.inf], [torch.nan, 1.0], [1.0, 2.0]], dtype=torch.float64)
    both(policy, x0, n_steps=5)


@torch.no_grad()
def test_diverging_motions_are_data(random_policy, randn):
    policy, x0 = random_policy(3, batch=(20,)), randn(2)
    policy.unpack(40.0 * policy.pack().detach())
    fused, eager = (rollout(policy, x0, 400, 0.3, backend=backend).x for backend in ("fused", "eager"))
    early = eager[:, :60]  # later, round-off has grown as the motion has
    assert ((fused[:, :60] - early).abs() <= 1e-9 * early.abs().amax((-2, -1), keepdim=True)).all()
    failed = ~eager[:, -1].isfinite().all(-1)
    assert failed.any() and not failed.all() and torch.equal(failed, ~fused[:, -1].isfinite().all(-1))
    bounded = both(policy, x0, n_steps=200, dt=0.3, rtol=1e-9, stop=Bounds(-1e3, 1e3))
    assert bounded.x.isfinite().all() and bounded.stopped.any()
