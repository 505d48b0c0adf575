"""On a GPU: roll-outs in one kernel against the CPU, and how long they take."""

import copy
import time

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import close
from tests.torchds.kernels.test_cpu import FORCES
from tests.torchds.kernels.test_fused import WALLS
from torchds import Bounds, GMRPolicy, kernels, rollout
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass
from train.learning.learner import Learner
from train.options import options_for

pytestmark = pytest.mark.gpu


@torch.no_grad()
def same(policy, x0, n_steps=100, dt=0.02, rtol=1e-10, **options):
    """The roll-out of a GPU, compared with that of the eager loop on the CPU."""
    here = rollout(policy, x0, n_steps, dt, backend="eager", **options)
    moved = {name: option.to("cuda") if hasattr(option, "to") else option for name, option in options.items()}
    there = rollout(copy.deepcopy(policy).to("cuda"), x0.to("cuda"), n_steps, dt, backend="fused", **moved)
    assert there.x.is_cuda
    close(there.to("cpu"), here, rtol)
    return here


def test_there_is_a_kernel():
    assert kernels.available()["cuda"]


@pytest.mark.parametrize(("K", "D", "O", "Q"), [(1, 1, 1, 0), (4, 2, 2, 0), (3, 2, 3, 1), (5, 3, 3, 3)])
@pytest.mark.parametrize(("batch", "points"), [((), ()), ((7,), ()), ((3, 2), (2, 2)), ((500,), (3,))])
def test_a_rollout_is_that_of_the_cpu(random_policy, randn, K, D, O, Q, batch, points):
    policy = random_policy(K, D, O, Q, batch=batch)
    same(policy, randn(*points, D))
    same(policy, randn(*batch, *points, D), starts="per_policy", shift=randn(D))


def test_gatings_and_shifts_of_their_own(random_mixture, randn):
    policy = GMRPolicy.from_mixture(random_mixture(3, 4, batch=(5,)), 2)
    tried = policy.pack().detach()
    policy.unpack(tried + 0.1 * randn(3, *tried.shape))
    for shift in (randn(2), randn(4, 2), randn(5, 1, 2), randn(3, 5, 4, 2)):
        same(policy, randn(4, 2), shift=shift)


@pytest.mark.parametrize("stop", [Bounds(-1.5, torch.tensor([1.0, 0.9]).double()), WALLS], ids=["bounds", "walls"])
def test_stop_conditions(random_policy, randn, stop):
    path = same(random_policy(4, 2, 2, 1, batch=(40,)), 0.5 * randn(5, 2), stop=stop)
    assert path.stopped.any() and not path.stopped.all()


@pytest.mark.parametrize("form", ["implicit", "explicit"])
@pytest.mark.parametrize("force", FORCES.values(), ids=FORCES)
def test_plants(random_policy, randn, form, force):
    policy, x0 = random_policy(4, 2, 2, 2, batch=(20,)), 0.5 * randn(2, 2)
    for options in ({"low": 0.2, "high": 0.4}, {"max_rate": 2.0, "rows": (1, 0)}, {"stiffness": 7.0}):
        same(policy, x0, n_steps=50, plant=ImpedanceControlled(PointMass(1.3, 0.7, force), form=form, **options))


def test_single_precision(random_policy, randn):
    policy = random_policy(4, 2, 2, 2, batch=(50,)).float()
    same(policy, randn(2).float(), n_steps=60, dt=0.01, rtol=2e-5, stop=Bounds(-3.0, 3.0))


def test_far_away_and_nowhere(random_policy, randn):
    policy = random_policy(4)
    for size in (1e3, 1e80, 1e160, 1e300):
        same(policy, size * randn(6, 2), n_steps=1)
    nowhere = torch.tensor([[torch.inf, 0.0], [0.0, -torch.inf], [torch.nan, 1.0]], dtype=torch.float64)
    same(policy, nowhere, n_steps=5)


@torch.no_grad()
def test_alone_the_numbers_are_the_same_to_the_last_bit(random_policy, randn):
    policy, x0 = random_policy(4).to("cuda"), randn(1000, 2).to("cuda")
    everyone, last = (rollout(policy, x, 200, 0.01, backend="fused").x for x in (x0, x0[-1]))
    assert torch.equal(everyone[-1], last)


def test_gradients_and_what_is_no_loop_are_eager(random_policy, randn):
    policy, x0 = random_policy(4).to("cuda"), randn(2).to("cuda")
    with pytest.raises(torchds.errors.InvalidArgumentError, match="gradients on a GPU need the eager loop"):
        rollout(policy, x0, 9, 0.1, backend="fused")
    rollout(policy, x0, 9, 0.1).x.square().sum().backward()
    assert policy.A.grad.is_cuda and policy.A.grad.isfinite().all()
    with torch.no_grad():
        assert not kernels.fits(x0)


def milliseconds(make, n):
    """Of one call, the fastest of `n`; the first one compiles."""
    taken = []
    for _ in range(n + 1):
        torch.cuda.synchronize()
        begin = time.perf_counter()
        make()
        torch.cuda.synchronize()
        taken.append(1e3 * (time.perf_counter() - begin))
    return min(taken[1:]), taken[0]


@torch.no_grad()
def test_times(random_policy, randn, capsys):
    """200 steps, K = 4, D = O = 2; to be at most 0.5 ms for 10, 1 ms for 1e5 and 6 ms for 1e6 in float64."""
    policy, x0 = random_policy(4), randn(2)
    eager = copy.deepcopy(policy).to("cuda")
    slow, _ = milliseconds(lambda: rollout(eager, x0.to("cuda").expand(10, 2), 200, 0.01, backend="eager"), 3)
    lines = [f"\n{torch.cuda.get_device_name()}, 200 steps; eager, 10 roll-outs: {slow:.2f} ms"]
    for dtype in (torch.float64, torch.float32):
        for n in (10, 200, 4000, 100_000, 1_000_000):
            if torch.cuda.mem_get_info()[0] < 2 * 201 * 8 * n * dtype.itemsize:
                continue
            theta = policy.pack().detach()
            many = copy.deepcopy(policy)
            many.unpack(theta + 0.01 * randn(n, *theta.shape))
            many, start = many.to("cuda", dtype), x0.to("cuda", dtype)
            fast, first = milliseconds(lambda p=many, x=start: rollout(p, x, 200, 0.01, backend="fused"), 20)
            lines.append(f"{dtype}, {n} roll-outs: {fast:.3f} ms, the first call {first:.0f} ms")
            assert n > 10 or fast < 0.1 * slow
    with capsys.disabled():
        print("\n".join(lines))


def test_time_of_a_thousand_runs(capsys):
    """1000 runs of 50 updates of the N; to be at most 1 s."""
    for updates in (1, 50):
        chosen = options_for("via_point", shape="N", device="cuda", runs=1000, updates=updates, rollouts=10)
        learner = Learner(chosen)
        torch.cuda.synchronize()
        begin = time.perf_counter()
        learner.learn()
        torch.cuda.synchronize()
        taken = time.perf_counter() - begin
    with capsys.disabled():
        print(f"\n1000 runs, 50 updates: {taken:.2f} s")
