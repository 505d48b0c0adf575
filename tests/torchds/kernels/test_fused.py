"""Fused roll-outs against the eager loop, which is their definition."""

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import DT, T, both, needs_numba
from torchds import Bounds, Walls, rollout

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
    with pytest.raises(torchds.errors.InvalidArgumentError, match=r"shift has to be .* fit"):
        rollout(policy, x0, T, DT, shift=randn(5, 2), backend="fused")


@pytest.mark.parametrize(
    "stop", [Bounds(-1.5, 1.0), Bounds(torch.tensor([-1.0, -2.0]).double(), torch.tensor([9.0, 0.5]).double()), WALLS]
)
def test_stop_conditions(random_policy, randn, stop):
    path = both(random_policy(4, 2, 2, 1, batch=(40,)), 0.5 * randn(5, 2), dt=0.03, stop=stop)
    assert path.stopped.any() and not path.stopped.all()


@torch.no_grad()
@pytest.mark.slow
def test_diverging_motions_are_data(random_policy, randn):
    policy, x0 = random_policy(3, batch=(20,)), randn(2)
    policy.unpack(40.0 * policy.pack().detach())
    fused, eager = (rollout(policy, x0, 400, 0.3, backend=backend).x for backend in ("fused", "eager"))
    ends = [path[:, -1].isfinite().all(-1) for path in (fused, eager)]
    assert torch.equal(*ends) and ends[1].any() and not ends[1].all()
    assert fused[:, 1:][~fused[:, :-1].isfinite()].isfinite().sum() == 0  # what has left the numbers does not come back
    # One of the motions runs along a border of its gating, where round-off grows a thousandfold in ten steps. So all steps
    # are compared one by one, each from where the eager motion was.
    seen = eager[:, :-1]
    step = rollout(policy, seen, 1, 0.3, starts="per_policy", backend="fused").x[..., 1, :]
    assert torch.equal(step.isfinite(), eager[:, 1:].isfinite())
    below = (seen.abs() < 1e150).all(-1)
    assert below.any() and not below.all()
    size = eager[:, 1:].abs().amax(-1, keepdim=True)
    assert ((step - eager[:, 1:]).abs() <= 1e-12 * size)[below].all()
    bounded = both(policy, x0, n_steps=200, dt=0.3, rtol=1e-9, stop=Bounds(-1e3, 1e3))
    assert bounded.x.isfinite().all() and bounded.stopped.any()
