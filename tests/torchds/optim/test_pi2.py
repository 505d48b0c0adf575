"""PI² against dense printed formulas in numpy, against PI^BB where they coincide, and as a torch optimizer."""

import copy
import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn.functional import pad
from torch.optim import lr_scheduler

import torchds
from torchds import GMRPolicy, visits
from torchds.errors import AllRolloutsFailedError, EqualCostsWarning, InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous
from torchds.optim import PI2, PIBB, InverseIteration

# ------------------------------------------------------------------ a small task, in torch

N, T, DT = 6, 15, 0.1
START = torch.tensor([-1.2, 0.9], dtype=torch.float64)
VIA = torch.tensor([[-0.6, 0.5], [0.3, -0.4]], dtype=torch.float64)
GOAL = torch.tensor([0.8, -0.3], dtype=torch.float64)
PRIORS = [0.4, 0.6]
MEANS = [[-0.9, 0.6], [0.5, -0.4]]
COVARIANCES = [[[0.4, 0.1], [0.1, 0.2]], [[0.3, -0.1], [-0.1, 0.5]]]
A = [[[-0.5, 0.4], [-0.2, -0.7]], [[-0.9, -0.3], [0.1, -0.4]]]
B = [[0.3, -0.4], [0.5, -0.1]]
STIFFNESS_A, STIFFNESS_B = [[[0.3, -0.2]], [[-0.1, 0.4]]], [[2.0], [1.5]]


def make_policy(dtype=torch.float64, Q=0):
    values = {"priors": PRIORS, "means": MEANS, "covariances": COVARIANCES, "A": A, "b": B}
    if Q:
        values |= {"stiffness_A": STIFFNESS_A, "stiffness_b": STIFFNESS_B}
    return GMRPolicy(**{name: torch.tensor(value, dtype=dtype) for name, value in values.items()})


def make_optimizer(policy, cls=PI2, **options):
    noise = Homogeneous(policy, 0.3, "centre", mean_stiffness=0.4)
    return cls(policy.parameters(), noise, **{"n_rollouts": N, "control_weight": 0.05, **options})


def step_costs(path):
    """(*batch, T): what a step costs, via-points and goal at the end."""
    costs = torchds.costs
    terminal = costs.via_points(path.x, VIA.to(path.x)) + costs.goal(path.x, GOAL.to(path.x))
    running = costs.acceleration_steps(path.v) + 0.05 * path.x[..., 1:, 0].square()
    if path.stiffness is not None:
        running = running + 0.1 * path.stiffness.abs().sum(-1)
    return running + pad(terminal.unsqueeze(-1), (running.shape[-1] - 1, 0))


def make_closure(policy, x0=START, n_steps=T):
    return lambda: step_costs(torchds.rollout(policy, x0.to(policy.A.dtype), n_steps, DT))


def make_normals(policy, updates, n=N, seed=5):
    """Unit normals of every update, one group of all parameters."""
    generator = torch.Generator().manual_seed(seed)
    shapes = [(n, *p.shape) for p in policy.parameters()]
    return [[torch.randn(s, dtype=policy.A.dtype, generator=generator) for s in shapes] for _ in range(updates)]


def learn(optim, closure, normals):
    for z in normals:
        optim.ask([z])
        optim.step(closure)


def theta_of(policy):
    return policy.pack().detach().clone()


# ------------------------------------------------------------------ the printed formulas, in numpy


class Reference:
    """θ flat, G and M dense, one roll-out and one time step after the other."""

    def __init__(self, r, weighting, projected, Q):
        self.r, self.weighting, self.projected, self.n = r, weighting, projected, 2 + Q
        blocks = []
        for k in range(2):  # Eq. 10-11, 44-45
            slopes, offsets = list(A[k]), list(B[k])
            if Q:
                slopes, offsets = slopes + STIFFNESS_A[k], offsets + STIFFNESS_B[k]
            blocks += [np.ravel(slopes), offsets]
        self.initial = np.concatenate(blocks)
        self.theta = self.initial.copy()

    def h(self, x):
        """Eq. 2."""
        density = []
        for prior, mu, sigma in zip(PRIORS, np.array(MEANS), np.array(COVARIANCES), strict=True):
            distance = (x - mu) @ np.linalg.inv(sigma) @ (x - mu)
            density.append(prior * math.exp(-0.5 * distance) / math.sqrt(np.linalg.det(2 * math.pi * sigma)))
        return np.array(density) / sum(density)

    def G(self, x):
        """Eq. 8-9, 42-43."""
        return np.hstack([h * np.hstack([np.kron(np.eye(self.n), x), np.eye(self.n)]) for h in self.h(x)])

    def M(self, x):
        """Line 15; any multiple of the identity gives the same M, so r = 0 does too."""
        inverse = np.eye(len(self.theta)) / (self.r or 1.0)
        G = self.G(x)
        return inverse @ G.T @ np.linalg.inv(G @ inverse @ G.T) @ G

    def rollout(self, epsilon):
        """q (T,), Υ (T,), M ε (T, P) and h_k (T, K) of one roll-out."""
        x, X, V, upsilon, moved, gating, stiffness = START.numpy(), [START.numpy()], [], [], [], [], []
        R = self.r * np.eye(len(self.theta))
        for _ in range(T):
            moved.append(self.M(x) @ epsilon)
            deviation = self.theta - self.initial + moved[-1]
            upsilon.append(deviation @ R @ deviation)
            gating.append(self.h(x))
            y = self.G(x) @ (self.theta + epsilon)
            V.append(y[:2])
            stiffness.append(y[2:])
            x = x + DT * y[:2]
            X.append(x)
        q = [0.0] + [np.linalg.norm(b - a) for a, b in pairwise(V)]
        q = [q_t + 0.05 * X[t + 1][0] ** 2 + 0.1 * np.abs(stiffness[t]).sum() for t, q_t in enumerate(q)]
        q[-1] += sum(min(np.sum((p - x) ** 2) for x in X[1:]) for p in VIA.numpy())
        q[-1] += np.sum((GOAL.numpy() - X[-1]) ** 2)
        if not self.projected:
            moved = [epsilon] * T
        return np.array(q), np.array(upsilon), np.array(moved), np.array(gating)

    def update(self, epsilons):
        q, upsilon, moved, gating = zip(*map(self.rollout, epsilons), strict=True)
        n = len(epsilons)
        numerator, denominator = np.zeros_like(self.theta), np.zeros_like(self.theta)
        for t in range(T):
            S = np.array([sum(q[r][t:]) + 0.5 * sum(upsilon[r][t + 1 :]) for r in range(n)])
            P = np.exp(-10 * (S - S.min()) / (S.max() - S.min()))
            P /= P.sum()
            change = sum(P[r] * moved[r][t] for r in range(n))
            share = np.full(2, float(T - t))
            if self.weighting == "gating":
                share *= np.mean([gating[r][t] for r in range(n)], axis=0)
            share = np.repeat(share, len(self.theta) // 2)
            numerator += share * change
            denominator += share
        self.theta = self.theta + numerator / denominator
        return np.array([sum(q[r]) + 0.5 * sum(upsilon[r]) for r in range(n)])


@pytest.mark.parametrize("Q", [0, 1])
@pytest.mark.parametrize("weighting", ["gating", "time"])
@pytest.mark.parametrize("projected", [True, False])
@pytest.mark.parametrize(("control_weight", "batched"), [(0.05, True), (0.05, False), (0.0, True)])
@pytest.mark.slow
def test_three_updates_equal_the_dense_formulas(Q, weighting, projected, control_weight, batched):
    policy = make_policy(Q=Q)
    optim = make_optimizer(
        policy, weighting=weighting, projected=projected, control_weight=control_weight, batched=batched
    )
    reference = Reference(control_weight, weighting, projected, Q)
    np.testing.assert_array_equal(theta_of(policy), reference.theta)
    for z in make_normals(policy, 3):
        tried = dict(zip(policy.parameters(), optim.ask([z]), strict=True))
        epsilons = (policy.pack(lambda p, tried=tried: tried[p]) - policy.pack()).detach().numpy()
        mean = optim.step(make_closure(policy))
        costs = reference.update(epsilons)
        np.testing.assert_allclose(theta_of(policy), reference.theta, rtol=0, atol=1e-10)
        np.testing.assert_allclose(optim.last.cost, costs, rtol=1e-11)
        assert mean.item() == pytest.approx(costs.mean(), rel=1e-11)
    assert np.abs(reference.theta - reference.initial).max() > 0.02  # it went somewhere
    assert (optim.last.control.min() > 0.001) == (control_weight > 0)


@pytest.mark.parametrize("Q", [0, 1])
def test_one_step_with_one_rollout_moves_by_the_projected_noise(Q):
    policy = make_policy(Q=Q)
    optim = make_optimizer(policy, n_rollouts=1)
    tried = dict(zip(policy.parameters(), optim.ask(), strict=True))
    epsilon = (policy.pack(lambda p: tried[p][0]) - policy.pack()).detach().numpy()
    before = theta_of(policy).numpy()
    optim.step(make_closure(policy, n_steps=1))
    M = Reference(0.05, "time", True, Q).M(START.numpy())
    np.testing.assert_allclose(theta_of(policy).numpy() - before, M @ epsilon, rtol=0, atol=1e-10)
    np.testing.assert_allclose(M @ M, M, rtol=0, atol=1e-12)
    assert np.linalg.matrix_rank(M) == 2 + Q


@pytest.mark.parametrize("weighting", ["gating", "time"])
@pytest.mark.parametrize("temperature", ["range", "median", "capped"])
@pytest.mark.parametrize("Q", [0, 1])
def test_with_one_time_step_and_without_the_projection_it_equals_pibb(weighting, temperature, Q):
    policies = [make_policy(Q=Q), make_policy(Q=Q)]
    options = {"control_weight": 0.0, "temperature": temperature, "eliteness": 7.0}
    pi2 = make_optimizer(policies[0], weighting=weighting, projected=False, **options)
    pibb = make_optimizer(policies[1], PIBB, **options)
    for _ in range(3):
        pi2.step(make_closure(policies[0], n_steps=1))
        pibb.step(lambda: make_closure(policies[1], n_steps=1)().squeeze(-1))
    torch.testing.assert_close(theta_of(policies[0]), theta_of(policies[1]), rtol=0, atol=1e-12)
    torch.testing.assert_close(pi2.last.weights, pibb.last.weights, rtol=1e-10, atol=1e-12)
    assert not torch.allclose(theta_of(policies[0]), theta_of(make_policy(Q=Q)), atol=0.01)


def test_costs_that_are_all_equal_leave_the_parameters():
    policy = make_policy()
    optim = make_optimizer(policy, projected=False, control_weight=0.0, weighting="time")
    (z,) = make_normals(policy, 1)
    optim.ask([z])
    with pytest.warns(EqualCostsWarning, match="cost the same"):
        optim.step(lambda: 0 * make_closure(policy)())
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
    assert optim.last.weights.tolist() == pytest.approx([1 / N] * N)


def test_a_component_that_no_rollout_visits_stays_as_it_is():
    policy = make_policy()
    policy.means[1] += 1000.0
    policy = GMRPolicy(policy.priors, policy.means, policy.covariances, policy.A, policy.b)
    before = theta_of(policy)
    make_optimizer(policy, projected=False).step(make_closure(policy))
    changed = theta_of(policy) != before
    assert changed[:6].all()
    assert not changed[6:].any()


# ------------------------------------------------------------------ batches, ways to evaluate


@pytest.mark.parametrize("weighting", ["gating", "time"])
@pytest.mark.slow
def test_independent_runs_equal_runs_on_their_own(weighting):
    R = 4
    runs = make_policy().expand(R)
    with torch.no_grad():
        runs.A.add_(0.1 * torch.randn(runs.A.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2)))
    normals = make_normals(runs, 3)
    singles = []
    for r in range(R):
        single = make_policy()
        single.unpack(theta_of(runs)[r])
        optim = make_optimizer(single, weighting=weighting)
        learn(optim, make_closure(single), [[z[:, r] for z in update] for update in normals])
        singles.append((theta_of(single), *optim.last))
    optim = make_optimizer(runs, weighting=weighting)
    learn(optim, make_closure(runs), normals)
    assert optim.last.cost.shape == optim.last.weights.shape == (N, R)
    together = (theta_of(runs), *(value.mT for value in optim.last))
    for mine, alone in zip(together, zip(*singles, strict=True), strict=True):
        torch.testing.assert_close(mine, torch.stack(alone), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.slow
def test_one_call_each_and_ask_with_tell_equal_one_call_for_all(batch):
    results = []
    for way in ("batched", "sequential", "ask"):
        policy = make_policy(Q=1).expand(*batch)
        optim = make_optimizer(policy, batched=way != "sequential")
        for _ in range(3):
            if way == "ask":
                trial = policy.expand()
                for p, values in zip(trial.parameters(), optim.ask(), strict=True):
                    p.data = values
                with visits.listen() as seen, torch.no_grad():
                    costs = make_closure(trial)()
                optim.tell(costs, [visits.Visit(policy, visit.features) for visit in seen])
            else:
                optim.step(make_closure(policy))
        results.append((theta_of(policy), *optim.last))
    for other in results[1:]:
        for mine, theirs in zip(results[0], other, strict=True):
            torch.testing.assert_close(mine, theirs, rtol=1e-11, atol=1e-12)


def test_groups_have_their_own_scale_and_weighting():
    """Each group takes its own part of an update with its own options."""
    split, whole = make_policy(), {w: make_policy() for w in ("gating", "time")}
    groups = [{"params": [split.A], "weighting": "gating"}, {"params": [split.b], "weighting": "time"}]
    optim = PI2(groups, Homogeneous(split, 0.3, "centre"), N)
    (z,) = make_normals(split, 1)
    optim.ask([[z[0]], [z[1]]])
    optim.step(make_closure(split))
    for weighting, policy in whole.items():
        learn(make_optimizer(policy, weighting=weighting, control_weight=0.0), make_closure(policy), [z])
    torch.testing.assert_close(split.A, whole["gating"].A, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(split.b, whole["time"].b, rtol=1e-12, atol=1e-14)
    assert not torch.allclose(split.b, whole["gating"].b)


@pytest.mark.slow
def test_learning_makes_the_motion_cheaper():
    policy = make_policy()
    optim = make_optimizer(policy, control_weight=1e-4)
    before = make_closure(policy)().sum().item()
    for _ in range(40):
        optim.step(make_closure(policy))
    assert make_closure(policy)().sum().item() < 0.6 * before


def test_float32_learns_the_same_in_its_precision():
    results = []
    for dtype in (torch.float32, torch.float64):
        policy = make_policy(dtype)
        optim = make_optimizer(policy)
        learn(optim, make_closure(policy), [[z.to(dtype) for z in u] for u in make_normals(make_policy(), 3)])
        assert policy.A.dtype == optim.last.cost.dtype == optim.last.weights.dtype == dtype
        results.append(theta_of(policy).double())
    torch.testing.assert_close(*results, rtol=1e-4, atol=1e-4)


# ------------------------------------------------------------------ failures


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("step", [0, 7, T - 1])
@pytest.mark.parametrize("weighting", ["gating", "time"])
def test_a_rollout_that_fails_anywhere_is_as_if_it_had_never_been(bad, step, weighting):
    policy, valid = make_policy(), make_policy()
    (normals,) = make_normals(policy, 1)
    optim = make_optimizer(policy, weighting=weighting)

    def closure():
        costs = make_closure(policy)()
        costs[2, step] = bad
        return costs

    optim.ask([normals])
    mean = optim.step(closure)
    assert optim.last.failed.tolist() == [n == 2 for n in range(N)]
    assert optim.last.weights[2] == 0
    others = [n for n in range(N) if n != 2]
    without = make_optimizer(valid, n_rollouts=N - 1, weighting=weighting)
    without.ask([[z[others] for z in normals]])
    torch.testing.assert_close(mean, without.step(make_closure(valid)), rtol=1e-12, atol=0)
    torch.testing.assert_close(theta_of(policy), theta_of(valid), rtol=0, atol=1e-13)


@pytest.mark.parametrize("control_weight", [0.0, 0.05])
@pytest.mark.parametrize("projected", [True, False])
@pytest.mark.parametrize("weighting", ["gating", "time"])
def test_a_diverged_rollout_is_data_whose_features_do_not_reach_the_parameters(control_weight, projected, weighting):
    policy, valid = make_policy(), make_policy()
    options = {"control_weight": control_weight, "projected": projected, "weighting": weighting}
    (normals,) = make_normals(policy, 1)
    normals[0][3] = 1e200
    optim = make_optimizer(policy, **options)
    learn(optim, make_closure(policy), [normals])
    assert optim.last.failed.tolist() == [n == 3 for n in range(N)]
    others = [n for n in range(N) if n != 3]
    without = make_optimizer(valid, n_rollouts=N - 1, **options)
    learn(without, make_closure(valid), [[z[others] for z in normals]])
    torch.testing.assert_close(theta_of(policy), theta_of(valid), rtol=0, atol=1e-13)


def test_a_diverged_rollout_with_a_finite_cost_does_not_spoil_the_parameters():
    policy = make_policy()
    (normals,) = make_normals(policy, 1)
    normals[0][3] = 1e200
    optim = make_optimizer(policy, control_weight=0.0)
    learn(optim, lambda: make_closure(policy)().nan_to_num(100.0, 100.0).clamp(max=100.0), [normals])
    assert not optim.last.failed.any()
    assert theta_of(policy).isfinite().all()
    assert not torch.equal(theta_of(policy), theta_of(make_policy()))


@pytest.mark.parametrize("asked", [True, False])
def test_all_failing_raises_and_leaves_the_policy(asked):
    policy = make_policy()
    optim = make_optimizer(policy)
    if asked:
        optim.ask()
    with pytest.raises(AllRolloutsFailedError, match=f"all {N} roll-outs had a cost that is not finite"):
        optim.step(lambda: make_closure(policy)() * torch.nan)
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
    optim.step(make_closure(policy))
    assert not torch.equal(theta_of(policy), theta_of(make_policy()))


def test_one_run_that_fails_altogether_stays_while_the_others_learn():
    normals = make_normals(make_policy().expand(3), 1)
    results = []
    for fail in (False, True):
        runs = make_policy().expand(3)
        optim = make_optimizer(runs)

        def closure(runs=runs, fail=fail):
            costs = make_closure(runs)()
            costs[:, 1, 4] = torch.nan if fail else costs[:, 1, 4]
            return costs

        learn(optim, closure, normals)
        results.append(theta_of(runs))
    assert torch.equal(results[1][1], theta_of(make_policy()))
    assert torch.equal(results[1][[0, 2]], results[0][[0, 2]])
    assert not torch.equal(results[0][1], results[1][1])


# ------------------------------------------------------------------ refusals


def both_starts(policy):
    """One roll-out from two points, its costs added."""
    return make_closure(policy, torch.stack([START, -START]))().sum(-2)


FIT = r"PI2 needs one roll-out from one start whose T steps are those of the costs "


@pytest.mark.parametrize(
    ("closure", "message"),
    [
        (lambda p: make_closure(p)().sum(-1), FIT + r"\(6,\); the closure made 1, the first of \(6, 15\) steps"),
        (lambda p: make_closure(p)()[:, :-1], FIT + r"\(6, 14\); the closure made 1, the first of \(6, 15\) steps"),
        (lambda p: make_closure(p)() + make_closure(p)(), FIT + r"\(6, 15\); the closure made 2, the first of"),
        (both_starts, FIT + r"\(6, 15\); the closure made 1, the first of \(6, 2, 15\) steps"),
        (lambda p: make_closure(p)()[:5], r"costs of shape \(6, \*batch, T\).*got \(5, 15\) for parameters"),
        (lambda p: make_closure(p)()[:, None].expand(-1, 3, -1), r"costs of shape \(6, \*batch, T\).*got \(6, 3, 15\)"),
        (lambda p: make_closure(p)().sum(), r"costs of shape \(6, \*batch, T\).*got \(\)"),
        (lambda p: torch.zeros(6, 15), "control_weight > 0 and PI2 need to know which features the roll-outs"),
        (lambda p: make_closure(make_policy())().expand(6, -1), "need to know which features the roll-outs of the opt"),
    ],
    ids=[
        "total costs",
        "a step short",
        "two roll-outs",
        "two starts",
        "five",
        "batch",
        "number",
        "no visit",
        "foreign",
    ],
)
@pytest.mark.parametrize("control_weight", [0.0, 0.05])
def test_a_closure_that_does_not_fit_is_refused_and_changes_nothing(closure, message, control_weight):
    policy = make_policy()
    optim = make_optimizer(policy, control_weight=control_weight, elite="best")
    with pytest.raises(InvalidArgumentError, match=message):
        optim.step(lambda: closure(policy))
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
    assert optim.last is None
    assert not any(optim.state.values())  # neither noise nor a best policy is left behind
    optim.step(make_closure(policy))
    assert not torch.equal(theta_of(policy), theta_of(make_policy()))


def test_what_was_asked_outlives_a_closure_that_does_not_fit():
    policy, seen = make_policy(), []
    optim = make_optimizer(policy)
    tried = [t.clone() for t in optim.ask()]
    with pytest.raises(InvalidArgumentError, match="PI2 needs one roll-out"):
        optim.step(lambda: make_closure(policy)().sum(-1))
    optim.step(lambda: seen.extend(p.data for p in policy.parameters()) or make_closure(policy)())
    assert all(map(torch.equal, tried, seen))


def test_parameters_that_are_not_of_the_policy_are_refused():
    policy, stranger = make_policy(), nn.Parameter(torch.zeros(3, dtype=torch.float64))
    optim = PI2([*policy.parameters(), stranger], Gaussian(0.1), N)
    with pytest.raises(InvalidArgumentError, match=r"PI2 moves the parameters of the policy.*of shape \[\(3,\)\]; use"):
        optim.step(make_closure(policy))
    assert torch.equal(theta_of(policy), theta_of(make_policy()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weighting": "h"}, "weighting has to be 'gating' or 'time', got 'h'"),
        ({"eliteness": 0.0}, "eliteness has to be positive, got 0.0"),
        ({"temperature": "max"}, "temperature has to be 'range', 'median' or 'capped', got 'max'"),
        ({"lr": -1.0}, "lr has to be ≥ 0, got -1.0"),
        ({"control_weight": float("nan")}, "control_weight has to be ≥ 0, got nan"),
        ({"n_rollouts": 0}, "n_rollouts has to be at least 1, got 0"),
        ({"control_reference": "none"}, "control_reference has to be 'demonstrated' or 'zero', got 'none'"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(InvalidArgumentError, match=message):
        make_optimizer(make_policy(), **options)


def test_a_step_without_closure_and_tell_without_ask_are_refused():
    optim = make_optimizer(make_policy())
    with pytest.raises(InvalidArgumentError, match="step needs a closure that returns the cost"):
        optim.step()
    with pytest.raises(InvalidArgumentError, match=r"tell\(costs\) finishes what ask\(\) began; call ask\(\) first"):
        optim.tell(torch.zeros(N, T))


# ------------------------------------------------------------------ the torch contract


def make_learner():
    policy = make_policy()
    optim = make_optimizer(policy, elite="best")
    return policy, optim, lr_scheduler.LambdaLR(optim, InverseIteration(0.2))


def run(policy, optim, decay, updates):
    for _ in range(updates):
        optim.step(make_closure(policy))
        decay.step()


def test_it_is_an_optimizer_whose_options_live_in_its_groups():
    policy = make_policy()
    optim = PI2(policy.parameters(), Homogeneous(policy), lr=0.5, weighting="time", projected=False)
    assert isinstance(optim, torch.optim.Optimizer)
    options = {
        "lr": 0.5,
        "eliteness": 10.0,
        "temperature": "range",
        "weighting": "time",
        "projected": False,
        "control_weight": 0.0,
    }
    (group,) = optim.param_groups
    assert group == {"params": list(policy.parameters()), **options}


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.slow
def test_a_run_continues_from_a_checkpoint_bit_for_bit(tmp_path, asked):
    whole = make_learner()
    run(*whole, 3)
    if asked:
        whole[1].ask()
    names = ("policy", "optim", "decay")
    torch.save({name: part.state_dict() for name, part in zip(names, whole, strict=True)}, tmp_path / "run.pt")
    saved = torch.load(tmp_path / "run.pt", weights_only=True)
    resumed = make_learner()
    run(*resumed, 1)
    for name, part in zip(names, resumed, strict=True):
        part.load_state_dict(saved[name])
    for learner in (whole, resumed):
        run(*learner, 3)
    assert torch.equal(whole[0].pack(), resumed[0].pack())
    assert torch.equal(whole[1].generator.get_state(), resumed[1].generator.get_state())
    assert all(map(torch.equal, whole[1].last, resumed[1].last))


def test_a_deep_copy_continues_equally_on_parameters_of_its_own():
    policy, optim, decay = make_learner()
    run(policy, optim, decay, 2)
    twin, twin_optim, twin_decay = copy.deepcopy((policy, optim, decay))
    before = twin.pack()
    run(policy, optim, decay, 3)
    assert torch.equal(twin.pack(), before)
    run(twin, twin_optim, twin_decay, 3)
    assert torch.equal(twin.pack(), policy.pack())
    assert not torch.equal(twin.pack(), before)


def test_hooks_fire_once_for_a_step_and_once_for_tell():
    policy = make_policy()
    optim = make_optimizer(policy)
    fired = []
    optim.register_step_pre_hook(lambda *_: fired.append("pre"))
    optim.register_step_post_hook(lambda *_: fired.append("post"))
    optim.step(make_closure(policy))
    assert fired == ["pre", "post"]
    optim.ask()
    with visits.listen() as seen, torch.no_grad():
        costs = make_closure(make_policy())().expand(N, -1)
    features = seen[0].features.expand(N, -1, -1)
    optim.tell(costs, [visits.Visit(policy, features)])
    assert fired == ["pre", "post"] * 2


@pytest.mark.parametrize(
    "make_scheduler",
    [
        lambda o: lr_scheduler.LambdaLR(o, InverseIteration()),
        lambda o: lr_scheduler.ExponentialLR(o, 0.8),
        lambda o: lr_scheduler.ReduceLROnPlateau(o, patience=0, threshold=10.0),
    ],
    ids=["LambdaLR", "ExponentialLR", "ReduceLROnPlateau"],
)
def test_a_scheduler_decays_the_exploration(make_scheduler):
    policy = make_policy()
    optim = make_optimizer(policy, lr=0.6)
    scheduler = make_scheduler(optim)
    (z,) = make_normals(policy, 1)
    std = optim.explorations[0].std()["A"]
    rates = []
    for _ in range(4):
        before = policy.A.detach().clone()
        rates.append(optim.param_groups[0]["lr"])
        tried = optim.ask([z])[0]
        torch.testing.assert_close(tried - before, rates[-1] * std * z[0], rtol=1e-12, atol=1e-14)
        cost = optim.step(make_closure(policy))
        scheduler.step(*([cost] if isinstance(scheduler, lr_scheduler.ReduceLROnPlateau) else []))
    assert len(set(rates)) > 1


def test_zero_lr_leaves_the_policy():
    policy = make_policy()
    make_optimizer(policy, lr=0.0).step(make_closure(policy))
    assert torch.equal(theta_of(policy), theta_of(make_policy()))
