"""PI^BB against Algorithm 1 in numpy, a loop of single runs, and arithmetic by hand."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import nn

import torchds
from torchds import GMRPolicy, visits
from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous
from torchds.optim import PIBB

# ------------------------------------------------------------------ a small task, in torch

N, T, DT = 6, 15, 0.1
START = torch.tensor([-1.2, 0.9], dtype=torch.float64)
STARTS = torch.tensor([[-1.2, 0.9], [-0.8, 0.2], [0.4, -0.6]], dtype=torch.float64)
VIA = torch.tensor([[-0.6, 0.5], [0.3, -0.4]], dtype=torch.float64)
GOAL = torch.tensor([0.8, -0.3], dtype=torch.float64)


def make_policy(dtype=torch.float64, Q=0):
    """Two Gaussians, and experts that are not alike in anything."""
    values = {
        "priors": [0.4, 0.6],
        "means": [[-0.9, 0.6], [0.5, -0.4]],
        "covariances": [[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]],
        "A": [[[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]],
        "b": [[0.3, -0.4], [0.5, -0.1]],
    }
    if Q:
        values |= {"stiffness_A": [[[0.3, -0.2]] * Q] * 2, "stiffness_b": [[2.0] * Q] * 2}
    return GMRPolicy(**{name: torch.tensor(value, dtype=dtype) for name, value in values.items()})


def cost_of(path):
    costs = torchds.costs
    return costs.via_points(path.x, VIA.to(path.x)) + costs.goal(path.x, GOAL.to(path.x)) + costs.acceleration(path.v)


def make_closure(policy, x0=START):
    return lambda: cost_of(torchds.rollout(policy, x0.to(policy.A.dtype), T, DT))


def make_normals(policy, updates, n=N, seed=5):
    """Unit normals of every update, one group of all parameters."""
    generator = torch.Generator().manual_seed(seed)
    shapes = [(n, *p.shape) for p in policy.parameters()]
    return [[torch.randn(s, dtype=policy.A.dtype, generator=generator) for s in shapes] for _ in range(updates)]


def make_optimizer(policy, speed=0.3, **options):
    defaults = {"n_rollouts": N, "control_weight": 0.05}
    return PIBB(policy.parameters(), Homogeneous(policy, speed, "centre"), **{**defaults, **options})


def learn(optim, closure, normals):
    """Updates with given normals."""
    for z in normals:
        optim.ask([z])
        optim.step(closure)


def theta_of(policy):
    return policy.pack().detach().clone()


# ------------------------------------------------------------------ Algorithm 1, in numpy


class Reference:
    """Lines 11-24 as they are printed: θ flat, G and M dense, one roll-out after the other."""

    def __init__(self, control_weight, zero_reference):
        self.mu = np.array([[-0.9, 0.6], [0.5, -0.4]])
        self.sigma = np.array([[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]])
        self.initial = np.array([-0.5, 0.4, -0.2, -0.7, 0.3, -0.4, -0.9, -0.3, 0.1, -0.4, 0.5, -0.1])  # Eq. 10-11
        self.theta = self.initial.copy()
        self.theta_zero = np.zeros(12) if zero_reference else self.initial
        self.R = control_weight * np.eye(12)

    def G(self, x):
        """Eq. 8-9."""
        density = [
            prior * math.exp(-0.5 * (x - m) @ np.linalg.inv(s) @ (x - m)) / math.sqrt(np.linalg.det(2 * math.pi * s))
            for prior, m, s in zip([0.4, 0.6], self.mu, self.sigma, strict=True)
        ]
        block = np.array([[x[0], x[1], 0, 0, 1, 0], [0, 0, x[0], x[1], 0, 1]])
        return np.hstack([d / sum(density) * block for d in density])

    def standard_deviations(self, speed):
        """Eq. 16-18, with the indices that Eq. 14 asks for."""
        share = math.sqrt(2 * speed**2 / (3 * math.pi))
        return np.concatenate([share / np.abs([m[0], m[1], m[0], m[1], 1, 1]) for m in self.mu])

    def cost(self, theta, epsilon):
        x, X, V, upsilon = START.numpy(), [START.numpy()], [], 0.0
        for _ in range(T):
            G = self.G(x)
            inverse = np.linalg.inv(self.R)
            M = inverse @ G.T @ np.linalg.inv(G @ inverse @ G.T) @ G
            deviation = theta - self.theta_zero + M @ epsilon
            upsilon += deviation @ self.R @ deviation
            V.append(G @ (theta + epsilon))
            x = x + DT * V[-1]
            X.append(x)
        via = sum(min(np.sum((p - x) ** 2) for x in X[1:]) for p in VIA.numpy())
        running = sum(np.linalg.norm(b - a) for a, b in pairwise(V))
        return via + np.sum((GOAL.numpy() - X[-1]) ** 2) + running + 0.5 * upsilon

    def update(self, n_iter, z, speed):
        alpha = max(1 / n_iter, 0.1)
        epsilons = [math.sqrt(alpha) * self.standard_deviations(speed) * z_r for z_r in z]
        S = np.array([self.cost(self.theta, e) for e in epsilons])
        weights = np.exp(-S / ((S.max() - S.min()) / 10))
        self.theta = self.theta + sum(w * e for w, e in zip(weights / weights.sum(), epsilons, strict=True))


def flat(normals):
    """(N, K, O, D) and (N, K, O) -> (N, P) in the order of Eq. 10-11."""
    A, b = (z.numpy() for z in normals)
    return [np.concatenate([np.concatenate([A[n, k].ravel(), b[n, k]]) for k in range(2)]) for n in range(len(A))]


@pytest.mark.parametrize("batched", [True, False])
@pytest.mark.parametrize("reference", ["demonstrated", "zero"])
@pytest.mark.slow
def test_three_updates_equal_lines_11_to_24_of_algorithm_1(reference, batched):
    policy = make_policy()
    optim = make_optimizer(policy, control_reference=reference, batched=batched)
    decay = torch.optim.lr_scheduler.LambdaLR(optim, torchds.optim.InverseIteration(0.1))
    numpy = Reference(0.05, reference == "zero")
    np.testing.assert_array_equal(theta_of(policy), numpy.theta)
    for n_iter, normals in enumerate(make_normals(policy, 3), start=1):
        optim.ask([normals])
        optim.step(make_closure(policy))
        decay.step()
        numpy.update(n_iter, flat(normals), 0.3)
        np.testing.assert_allclose(theta_of(policy), numpy.theta, rtol=0, atol=1e-10)
    assert np.abs(numpy.theta - numpy.initial).max() > 0.1  # it went somewhere
    assert optim.last.control.min() > 0.01  # and the control cost had a say


def test_two_rollouts_by_hand():
    theta = nn.Parameter(torch.tensor([1.0], dtype=torch.float64))
    optim = PIBB([theta], Gaussian(0.5), n_rollouts=2, lr=2.0, eliteness=3.0)
    (tried,) = optim.ask([[torch.tensor([[1.0], [-2.0]], dtype=torch.float64)]])
    assert tried.tolist() == [[2.0], [-1.0]]
    mean = optim.tell(torch.tensor([7.0, 5.0], dtype=torch.float64))
    first, second = math.exp(-3) / (1 + math.exp(-3)), 1 / (1 + math.exp(-3))  # λ = (7 − 5) / 3
    assert theta.item() == pytest.approx(1.0 + first * 1.0 - second * 2.0, rel=1e-14)
    assert mean.item() == 6.0
    assert optim.last.weights.tolist() == pytest.approx([first, second], rel=1e-14)
    assert optim.last.cost.tolist() == [7.0, 5.0]
    assert optim.last.control.tolist() == [0.0, 0.0]
    assert optim.last.failed.tolist() == [False, False]


# ------------------------------------------------------------------ the ways to evaluate


@pytest.mark.parametrize("Q", [0, 2])
@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.slow
def test_one_call_for_all_rollouts_equals_one_call_each_and_ask_with_tell(Q, batch):
    def evaluate(policy):
        path = torchds.rollout(policy, START, T, DT)
        return cost_of(path) + (policy.stiffness(path.x).square().mean((-1, -2)) if Q else 0.0)

    results = []
    for way in ("batched", "sequential", "ask"):
        policy = make_policy(Q=Q).expand(*batch) if batch else make_policy(Q=Q)
        noise = Homogeneous(policy, 0.3, mean_stiffness=0.4)
        optim = PIBB(policy.parameters(), noise, N, control_weight=0.05, batched=way != "sequential")
        for _ in range(3):
            if way == "ask":
                tried = optim.ask()
                trial = policy.expand()
                for p, values in zip(trial.parameters(), tried, strict=True):
                    p.data = values
                with visits.listen() as seen, torch.no_grad():
                    costs = evaluate(trial)
                optim.tell(costs, [visits.Visit(policy, visit.features) for visit in seen])
            else:
                optim.step(lambda policy=policy: evaluate(policy))
        results.append((theta_of(policy), *optim.last))
    for other in results[1:]:
        for mine, theirs in zip(results[0], other, strict=True):
            torch.testing.assert_close(mine, theirs, rtol=1e-12, atol=1e-13)


def test_the_closure_sees_the_parameters_as_ask_gives_them():
    policy, seen = make_policy(), []
    optim = make_optimizer(policy, control_weight=0.0)
    tried = optim.ask()
    optim.step(lambda: seen.extend(p.data for p in policy.parameters()) or make_closure(policy)())
    assert all(map(torch.equal, tried, seen))


@pytest.mark.parametrize("batched", [True, False])
def test_the_closure_runs_without_gradients_and_its_result_carries_none(batched):
    theta = nn.Parameter(torch.ones(2))
    enabled = []

    def closure():
        enabled.append(torch.is_grad_enabled())
        with torch.enable_grad():
            return theta.square().sum(-1)

    optim = PIBB([theta], Gaussian(0.1), n_rollouts=3, batched=batched)
    cost = optim.step(closure)
    assert enabled == [False] * (1 if batched else 3)
    assert torch.is_grad_enabled()
    assert theta.requires_grad
    assert theta.is_leaf
    assert not any(t.requires_grad for t in (cost, theta.data, *optim.last))


def test_plain_numbers_from_a_simulator_keep_the_precision_of_the_parameters():
    theta = nn.Parameter(torch.zeros(1, dtype=torch.float64))
    exact = [1e9 + n for n in range(4)]  # float32 cannot tell them apart
    optim = PIBB([theta], Gaussian(1.0), n_rollouts=4, batched=False)
    numbers = iter(exact)
    optim.step(lambda: next(numbers))
    assert optim.last.cost.tolist() == exact
    optim.ask()
    optim.tell(exact)
    assert optim.last.cost.tolist() == exact


def test_a_simulator_may_return_the_same_buffer_each_time():
    theta = nn.Parameter(torch.zeros(1))
    buffer = torch.zeros(())
    optim = PIBB([theta], Gaussian(1.0), n_rollouts=4, batched=False)
    optim.step(lambda: buffer.add_(1.0))
    assert optim.last.cost.tolist() == [1.0, 2.0, 3.0, 4.0]


# ------------------------------------------------------------------ many runs, many starts


@pytest.mark.slow
def test_independent_runs_equal_runs_on_their_own():
    R = 4
    runs = make_policy().expand(R)
    with torch.no_grad():  # runs need not begin alike; they share the demonstrated policy
        runs.A.add_(0.1 * torch.randn(runs.A.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2)))
    normals = make_normals(runs, 3)
    singles = []
    for r in range(R):
        single = make_policy()
        single.unpack(theta_of(runs)[r])
        optim = make_optimizer(single)
        learn(optim, make_closure(single), [[z[:, r] for z in update] for update in normals])
        singles.append((theta_of(single), *optim.last))
    optim = make_optimizer(runs)
    learn(optim, make_closure(runs), normals)
    assert optim.last.cost.shape == (N, R)
    together = (theta_of(runs), *(value.mT for value in optim.last))
    for mine, alone in zip(together, zip(*singles, strict=True), strict=True):
        torch.testing.assert_close(mine, torch.stack(alone), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_the_control_cost_of_several_starts_is_summed(batch):
    policy = make_policy().expand(*batch)
    with torch.no_grad():
        policy.b.add_(0.2)  # away from the demonstrated policy
    (normals,) = make_normals(policy, 1)

    def control_of(x0):
        learner = policy.expand()
        optim = make_optimizer(learner)
        learn(optim, lambda: cost_of(torchds.rollout(learner, x0, T, DT)).reshape(N, *batch, -1).sum(-1), [normals])
        return optim.last.control

    each = [control_of(x0) for x0 in STARTS]
    torch.testing.assert_close(control_of(STARTS), sum(each), rtol=1e-12, atol=0)
    torch.testing.assert_close(control_of(STARTS[:, None]), sum(each), rtol=1e-12, atol=0)
    assert min(c.min() for c in each) > 0


def test_two_rollouts_in_one_closure_cost_control_twice():
    policy = make_policy()
    (normals,) = make_normals(policy, 1)
    optim, twice = (make_optimizer(policy.expand()) for _ in range(2))
    for optimizer, times in ((optim, 1), (twice, 2)):
        closure = make_closure(optimizer.explorations[0].policy)
        learn(optimizer, lambda closure=closure, times=times: sum(closure() for _ in range(times)), [normals])
    torch.testing.assert_close(twice.last.cost, 2 * optim.last.cost, rtol=1e-12, atol=0)
    torch.testing.assert_close(twice.last.control, 2 * optim.last.control, rtol=1e-12, atol=0)


# ------------------------------------------------------------------ groups


def test_groups_have_their_own_exploration_lr_and_eliteness():
    a, b = (nn.Parameter(torch.zeros(2, dtype=torch.float64)) for _ in range(2))
    groups = [
        {"params": [a], "exploration": Gaussian(0.5), "lr": 2.0},
        {"params": [b], "eliteness": 1.0, "temperature": "median"},
    ]
    optim = PIBB(groups, Gaussian(0.1), n_rollouts=3)
    z = torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 2.0]], dtype=torch.float64)
    assert [t.tolist() for t in optim.ask([[z], [z]])] == [z.tolist(), (0.1 * z).tolist()]
    optim.tell(torch.tensor([0.0, 1.0, 4.0], dtype=torch.float64))
    for p, scale, exponents in ((a, 1.0, [0, 2.5, 10]), (b, 0.1, [0, 1, 4])):
        weights = np.exp(-np.array(exponents))
        np.testing.assert_allclose(p.detach(), scale * (weights / weights.sum()) @ z.numpy(), rtol=1e-12)


def dense_control(policy, theta_star, epsilon, r, x):
    """½ Σ_t Υ_t with the dense M of line 15, for R = diag(r) with all r positive."""
    total = 0.0
    for G in policy.basis(x).detach().numpy():
        inverse = np.diag(1 / r)
        M = inverse @ G.T @ np.linalg.inv(G @ inverse @ G.T) @ G
        moved = theta_star + M @ epsilon
        total += 0.5 * moved @ np.diag(r) @ moved
    return total


@pytest.mark.parametrize("batched", [True, False])
def test_groups_have_their_own_control_weight(batched):
    policy = make_policy()
    groups = [{"params": [policy.A], "control_weight": 0.3}, {"params": [policy.b], "control_weight": 0.02}]
    optim = PIBB(groups, Homogeneous(policy, 0.3), N, batched=batched)
    with torch.no_grad():
        policy.A.add_(0.1)
    center, paths = theta_of(policy), []
    theta_star = (center - theta_of(make_policy())).numpy()
    tried = optim.ask()

    def closure():
        path = torchds.rollout(policy, START, T, DT)
        paths.append(path.x)
        return cost_of(path)

    optim.step(closure)
    x = (paths[0] if batched else torch.stack(paths))[:, :-1]
    r = np.array([0.3, 0.3, 0.3, 0.3, 0.02, 0.02] * 2)
    for n in range(N):
        trial = make_policy()
        trial.A.data, trial.b.data = tried[0][n], tried[1][n]
        epsilon = (theta_of(trial) - center).numpy()
        expected = dense_control(policy, theta_star, epsilon, r, x[n])
        assert optim.last.control[n].item() == pytest.approx(expected, rel=1e-10)


def test_parameters_that_are_not_optimised_stay_and_cost_no_control():
    policy, expected = make_policy(), make_policy()
    free = PIBB([expected.A], Homogeneous(expected, 0.3, "centre"), N, control_weight=0.05, batched=False)
    optim = PIBB(
        [{"params": [policy.A]}, {"params": [policy.b], "exploration": Gaussian(0.0), "control_weight": 0.0}],
        Homogeneous(policy, 0.3, "centre"),
        N,
        control_weight=0.05,
    )
    for z_A, z_b in make_normals(policy, 3):
        optim.ask([[z_A], [z_b]])
        free.ask([[z_A]])
        optim.step(make_closure(policy))
        free.step(make_closure(expected))
    torch.testing.assert_close(theta_of(policy), theta_of(expected), rtol=1e-12, atol=1e-13)
    assert torch.equal(expected.b, make_policy().b)
    assert free.last.control.all()


def test_a_reference_policy_in_the_closure_costs_no_control():
    policy, nominal = make_policy(), make_policy()
    optims = [make_optimizer(policy.expand()) for _ in range(2)]
    for optim, other in zip(optims, (False, True), strict=True):
        learner = optim.explorations[0].policy

        def closure(learner=learner, other=other):
            if other:
                torchds.rollout(nominal, STARTS, T, DT)
            return make_closure(learner)()

        optim.step(closure)
    assert torch.equal(optims[0].last.control, optims[1].last.control)
    assert optims[0].last.control.all()


# ------------------------------------------------------------------ control cost and visits


@pytest.mark.parametrize("batched", [True, False])
def test_control_cost_without_visits_is_refused_and_says_what_to_do(batched):
    policy = make_policy()
    optim = make_optimizer(policy, batched=batched)
    message = "torchds.rollout in the closure, or call torchds.visits.report.* or give visits to tell.*control_weight=0"
    for closure in (lambda: policy.b.sum((-1, -2)), make_closure(make_policy())):
        with pytest.raises(InvalidArgumentError, match=message):
            optim.step(lambda closure=closure: closure().expand((N,) if batched else ()))
    optim.ask()
    with pytest.raises(InvalidArgumentError, match=message):
        optim.tell(torch.zeros(N, dtype=torch.float64))
    assert torch.equal(theta_of(policy), theta_of(make_policy()))


def test_a_foreign_simulator_that_reports_its_visits_learns_the_same():
    policies = [make_policy(), make_policy()]

    def simulate():
        policy = policies[1]
        x, X, V = START.expand(N, 2), [START.expand(N, 2)], []
        for _ in range(T):
            V.append((policy.A * x[:, None, None, :]).sum(-1) + policy.b)  # (N, K, O)
            V[-1] = (policy.gating(x)[..., None] * V[-1]).sum(-2)
            x = x + DT * V[-1]
            X.append(x)
        path = SimpleNamespace(x=torch.stack(X, -2), v=torch.stack(V, -2))
        visits.report(policy, policy.features(path.x[:, :-1]))
        return cost_of(path)

    for policy, closure in zip(policies, (make_closure(policies[0]), simulate), strict=True):
        optim = make_optimizer(policy)
        for _ in range(3):
            optim.step(closure)
    torch.testing.assert_close(theta_of(policies[0]), theta_of(policies[1]), rtol=1e-11, atol=1e-12)


# ------------------------------------------------------------------ limits


@pytest.mark.parametrize("batched", [True, False])
def test_zero_lr_leaves_the_policy(batched):
    policy = make_policy()
    optim = make_optimizer(policy, lr=0.0, batched=batched)
    optim.step(make_closure(policy))
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
    assert optim.last.weights.tolist() == pytest.approx([1 / N] * N)


def test_one_rollout_moves_by_its_noise():
    policy = make_policy()
    optim = make_optimizer(policy, n_rollouts=1)
    tried = optim.ask()
    optim.step(make_closure(policy))
    for p, trial in zip(policy.parameters(), tried, strict=True):
        torch.testing.assert_close(p.data, trial[0], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_learning_makes_the_motion_cheaper():
    policy = make_policy()
    optim = make_optimizer(policy, control_weight=1e-4)
    before = make_closure(policy)().item()
    for _ in range(40):
        optim.step(make_closure(policy))
    assert make_closure(policy)().item() < 0.5 * before


def test_the_same_seed_gives_the_same_run_and_another_does_not():
    def run(seed):
        policy = make_policy()
        optim = make_optimizer(policy, generator=torch.Generator().manual_seed(seed))
        torch.randn(seed + 1)  # the global generator plays no part
        for _ in range(3):
            optim.step(make_closure(policy))
        return theta_of(policy)

    assert torch.equal(run(1), run(1))
    assert not torch.equal(run(1), run(2))


def test_float32_learns_the_same_in_its_precision():
    results = []
    for dtype in (torch.float32, torch.float64):
        policy = make_policy(dtype)
        optim = make_optimizer(policy)
        normals = [[z.to(dtype) for z in update] for update in make_normals(make_policy(), 3)]
        learn(optim, make_closure(policy), normals)
        assert policy.A.dtype == optim.last.cost.dtype == optim.last.weights.dtype == dtype
        results.append(theta_of(policy).double())
    torch.testing.assert_close(*results, rtol=1e-4, atol=1e-4)


# ------------------------------------------------------------------ failures


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("batched", [True, False])
def test_a_failed_rollout_gets_weight_zero_and_is_counted(bad, batched):
    policy, valid = make_policy(), make_policy()
    (normals,) = make_normals(policy, 1)
    optim = make_optimizer(policy, batched=batched)
    calls = iter(range(N))

    def closure():
        costs = make_closure(policy)()
        if batched:
            costs[2] = bad
            return costs
        return costs if next(calls) != 2 else torch.tensor(bad)

    optim.ask([normals])
    mean = optim.step(closure)
    assert optim.last.failed.tolist() == [n == 2 for n in range(N)]
    assert optim.last.weights[2] == 0
    # It is as if that roll-out had never been.
    others = [n for n in range(N) if n != 2]
    without = make_optimizer(valid, n_rollouts=N - 1)
    without.ask([[z[others] for z in normals]])
    torch.testing.assert_close(mean, without.step(make_closure(valid)), rtol=1e-12, atol=0)
    torch.testing.assert_close(theta_of(policy), theta_of(valid), rtol=0, atol=1e-14)


def test_a_diverged_rollout_is_data():
    """Its control cost overflows too, which must not reach the parameters."""
    policy = make_policy()
    optim = make_optimizer(policy)
    (normals,) = make_normals(policy, 1)
    normals[0][3] = 1e200
    optim.ask([normals])
    optim.step(make_closure(policy))
    assert optim.last.failed.tolist() == [n == 3 for n in range(N)]
    assert theta_of(policy).isfinite().all()


@pytest.mark.parametrize("batched", [True, False])
@pytest.mark.parametrize("asked", [True, False])
def test_all_failing_raises_and_leaves_policy_and_optimizer_in_order(batched, asked):
    policy = make_policy()
    optim = make_optimizer(policy, batched=batched)
    tried = optim.ask() if asked else None
    with pytest.raises(AllRolloutsFailedError, match=f"all {N} roll-outs had a cost that is not finite.*Explore less"):
        optim.step(lambda: make_closure(policy)() * torch.nan)
    assert optim.last is None
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
    seen = []
    optim.step(lambda: seen.extend(p.data for p in policy.parameters()) or make_closure(policy)())
    if asked and batched:  # what was asked is still waiting
        assert all(map(torch.equal, tried, seen))
    assert not torch.equal(theta_of(policy), theta_of(make_policy()))


def test_one_run_that_fails_altogether_stays_while_the_others_learn():
    normals = make_normals(make_policy().expand(3), 1)
    results = []
    for fail in (False, True):
        runs = make_policy().expand(3)
        optim = make_optimizer(runs)

        def closure(runs=runs, fail=fail):
            costs = make_closure(runs)()
            costs[:, 1] = torch.nan if fail else costs[:, 1]
            return costs

        learn(optim, closure, normals)
        results.append(theta_of(runs))
    assert torch.equal(results[1][1], theta_of(make_policy()))
    assert torch.equal(results[1][[0, 2]], results[0][[0, 2]])
    assert not torch.equal(results[0][1], results[1][1])
    assert optim.last.failed.all(0).tolist() == [False, True, False]


@pytest.mark.parametrize("batched", [True, False])
def test_a_step_whose_closure_raises_is_as_if_it_had_not_been(batched):
    policy, tried = make_policy(), []

    def closure(fail):
        tried.append(policy.A.data.clone())
        if fail and len(tried) == (1 if batched else 3):
            raise ValueError("the robot has stopped")
        return make_closure(policy)()

    optim = make_optimizer(policy, batched=batched)
    with pytest.raises(ValueError, match="the robot has stopped"):
        optim.step(lambda: closure(True))
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
    assert visits.listener.get() is None
    with pytest.raises(InvalidArgumentError, match=r"call ask\(\) first"):
        optim.tell(torch.zeros(N))
    first = tried[0]
    tried.clear()
    optim.step(lambda: closure(False))
    assert torch.equal(first, tried[0])  # the generator is back, too
    assert not torch.equal(theta_of(policy), theta_of(make_policy()))


def test_what_was_asked_outlives_an_exception():
    policy = make_policy()
    optim = make_optimizer(policy)
    tried = [t.clone() for t in optim.ask()]
    with pytest.raises(ZeroDivisionError):
        optim.step(lambda: 1 / 0)
    with pytest.raises(InvalidArgumentError, match=r"costs of shape \(6, \*batch\).*got \(5,\)"):
        optim.tell(torch.zeros(5))
    seen = []
    optim.step(lambda: seen.extend(p.data for p in policy.parameters()) or make_closure(policy)())
    assert all(map(torch.equal, tried, seen))


def test_normals_that_do_not_fit_are_refused_and_leave_nothing_behind():
    policy = make_policy()
    groups = [{"params": [policy.A]}, {"params": [policy.b]}]
    optim = PIBB(groups, Homogeneous(policy), N)
    A, b = make_normals(policy, 1)[0]
    for normals in ([[A], [b[:-1]]], [[A]], [[A], [b, b]]):
        with pytest.raises(InvalidArgumentError, match=r"group 1 needs normals of shapes \[\(6, 2, 2\)\], got \["):
            optim.ask(normals)
        with pytest.raises(InvalidArgumentError, match=r"call ask\(\) first"):
            optim.tell(torch.zeros(N))
    tried = optim.ask()
    with pytest.raises(InvalidArgumentError, match="group 1 needs normals"):
        optim.ask([[A], [b[:-1]]])
    optim.tell(torch.tensor([0.0] + [torch.nan] * (N - 1)))  # of what was asked before: all weight on the first
    for p, trial in zip(policy.parameters(), tried, strict=True):
        torch.testing.assert_close(p.data, trial[0], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("costs", "batched", "message"),
    [
        (torch.zeros(()), True, r"costs of shape \(6, \*batch\).*got \(\) .*batched=False"),
        (torch.zeros(5), True, r"costs of shape \(6, \*batch\).*got \(5,\)"),
        (
            torch.zeros(6, 3),
            True,
            r"leading batch dimensions, got \(6, 3\) for parameters of shapes \[\(2, 2, 2\), \(2, 2\)\]",
        ),
        (torch.zeros(6), False, r"shape \(\*batch\) with batched=False.*got \(6, 6\)"),
    ],
)
def test_costs_of_a_wrong_shape_are_refused(costs, batched, message):
    policy = make_policy()
    optim = make_optimizer(policy, batched=batched)
    with pytest.raises(InvalidArgumentError, match=message):
        optim.step(lambda: costs)
    assert torch.equal(theta_of(policy), theta_of(make_policy()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_rollouts": 0}, "n_rollouts has to be at least 1, got 0"),
        ({"lr": -1.0}, "lr has to be ≥ 0, got -1.0"),
        ({"lr": float("nan")}, "lr has to be ≥ 0, got nan"),
        ({"control_weight": -1.0}, "control_weight has to be ≥ 0, got -1.0"),
        ({"eliteness": 0.0}, "eliteness has to be positive, got 0.0"),
        ({"temperature": "max"}, "temperature has to be 'range', 'median' or 'capped', got 'max'"),
        ({"control_reference": "initial"}, "control_reference has to be 'demonstrated' or 'zero', got 'initial'"),
        (
            {"exploration": None},
            "a group needs an exploration, e.g. exploration=torchds.exploration.Gaussian.*got None",
        ),
        ({"exploration": 0.1}, "a group needs an exploration.*got 0.1"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(InvalidArgumentError, match=message):
        PIBB(**{"params": [nn.Parameter(torch.zeros(2))], "exploration": Gaussian(0.1), **options})


def test_a_step_without_closure_and_tell_without_ask_are_refused():
    optim = PIBB([nn.Parameter(torch.zeros(2))], Gaussian(0.1))
    with pytest.raises(InvalidArgumentError, match="step needs a closure that returns the cost"):
        optim.step()
    with pytest.raises(InvalidArgumentError, match=r"tell\(costs\) finishes what ask\(\) began; call ask\(\) first"):
        optim.tell(torch.zeros(10))
