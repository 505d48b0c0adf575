"""The searchers behind --optimizer: what they spend, where they search, that they improve, repeat and resume."""

import copy

import numpy as np
import pytest
import torch

import tasks
from tests.motions import Short
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous, TrajectorySpace
from train.learning.learner import Learner
from train.options import options_for
from train.searchers.coordinates import Ask, Brief, CoordinateSearch, Method, free_entries, root
from train.searchers.named import METHODS
from train.searchers.sampled import SAMPLED

GRADIENTS = [name for name, method in METHODS.items() if method.gradient]
P = 24  # of four components in the plane


@pytest.fixture(scope="module")
def task():
    return Short()


def learner(task, name, updates=3, rollouts=5, **options):
    return Learner(
        options_for("via_point", runs=2, optimizer=name, updates=updates, rollouts=rollouts, **options), task
    )


def counted(learner):
    """The number of policies that each call of the closure evaluates, from the shapes of the parameters alone."""
    calls, closure = [], learner.closure

    def counting():
        calls.append(learner.policy.A[..., 0, 0, 0].numel())
        return closure()

    learner.closure = counting
    return calls


@pytest.mark.parametrize("exploration", ["homogeneous", "trajectory"])
@pytest.mark.parametrize("name", [*SAMPLED, *METHODS])
@pytest.mark.slow
def test_every_trial_is_counted_and_the_budget_is_kept(task, name, exploration):
    search = learner(task, name, updates=11, exploration=exploration)
    calls = counted(search)
    search.learn()
    history, runs = search.history, 2
    step = P + 1 if name == "finite_differences" else 5
    assert history.rollouts == list(range(0, 55 // step * step + 1, step))
    assert sum(calls) == runs * history.rollouts[-1]
    along = exploration == "trajectory"
    if name in SAMPLED:
        assert history.forward_equivalents == [(5 + 2 * along) * u for u in range(12)]
    else:
        each = 4 if name in GRADIENTS else 1
        assert history.forward_equivalents == [2 * along + each * n for n in history.rollouts]
    assert np.isfinite(history.cost).all()


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
def test_all_improve(task, name):
    history = learner(task, name, updates=8 if name in GRADIENTS else 20).learn().history
    assert np.median(history.cost[-1]) < 0.9 * np.median(history.cost[0])


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
def test_equal_seeds_give_equal_results_and_a_resumed_run_ends_bit_for_bit_as_an_undisturbed_one(task, name, tmp_path):
    options = {"updates": 12 if name == "finite_differences" else 4, "cost_noise": 0.01}
    whole = learner(task, name, **options).learn()
    first = learner(task, name, **options)
    first.start()
    first.update()
    torch.save(first.state_dict(), tmp_path / "checkpoint.pt")
    second = learner(task, name, **options)
    second.load_state_dict(torch.load(tmp_path / "checkpoint.pt", weights_only=True))
    second.learn()
    assert second.history.cost == whole.history.cost
    assert torch.equal(second.policy.pack(), whole.policy.pack())


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
def test_runs_differ_where_a_method_draws_or_the_cost_is_noisy_and_only_there(task, name):
    cost = learner(task, name, updates=5).learn().history.cost[-1]
    assert (cost[0] != cost[1]) == METHODS[name].random
    if not METHODS[name].gradient:  # noise that is added to the cost has no gradient
        noisy = learner(task, name, updates=15, cost_noise=0.1).learn().history.cost[-1]
        assert noisy[0] != noisy[1]


def test_noise_in_the_cost_has_the_size_that_was_asked_for(task):
    search = learner(task, "pibb", cost_noise=0.1)
    clean = learner(task, "pibb")
    with torch.no_grad():
        search.policy.unpack(search.policy.pack()[0].expand(2000, -1))
        noise = search.closure() - clean.closure()[0]
        initial = sum(task.evaluate(task.policy())[1].values())
    assert noise.std() == pytest.approx(0.1 * float(initial), rel=0.05)


@pytest.mark.parametrize("name", SAMPLED)
def test_noise_in_the_cost_changes_what_is_learned_and_resumes(task, name):
    clean = learner(task, name).learn()
    whole = learner(task, name, cost_noise=0.1).learn()
    assert whole.history.cost[-1] != clean.history.cost[-1]
    first, second = (learner(task, name, cost_noise=0.1) for _ in range(2))
    first.start()
    first.update()
    second.load_state_dict(first.state_dict())
    assert second.learn().history.cost == whole.history.cost


# ---------------------------------------------------------------------- coordinates


def test_the_root_of_homogeneous_noise_is_the_diagonal_of_its_standard_deviations(task):
    policy = task.policy().expand(2)
    L = root(policy, Homogeneous(policy, 0.2))
    std = policy.join(Homogeneous(policy, 0.2).std())
    assert torch.equal(L, torch.diag(std).expand(2, P, P))


def test_the_root_along_the_motion_is_the_factor_of_trajectory_space(task):
    policy = task.policy().expand(2)
    along = TrajectorySpace(policy, *task.motion(), spread=0.5)
    torch.testing.assert_close(root(policy, along), along.coordinates().factor, rtol=0, atol=0)


@pytest.mark.slow
def test_coordinates_with_a_goal_keep_it_a_fixed_point():
    options = {"runs": 2, "updates": 2, "rollouts": 5, "shrink": "none", "optimizer": "cma"}
    task = tasks.make("constrained_reaching")
    for exploration in ("stable", "stable-trajectory"):
        search = Learner(options_for("constrained_reaching", exploration=exploration, **options), task).learn()
        assert not torch.equal(search.policy.A[0], search.initial.A)
        at_goal = search.policy(search.task.goal.expand(2, 2))
        torch.testing.assert_close(at_goal, torch.zeros(2, 2, dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize("exploration", ["homogeneous", "trajectory"])
def test_gradients_in_z_agree_with_finite_differences(task, exploration):
    z = 0.1 * torch.randn(1, 2, P, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    twin = learner(task, "adam", exploration=exploration)
    exact = twin.searcher._try(twin.closure, z).gradient
    h = 1e-5
    steps = h * torch.eye(P, dtype=torch.float64).unsqueeze(1)
    ahead, behind = (twin.searcher._try(twin.closure, z + s).cost for s in (steps, -steps))
    torch.testing.assert_close(exact[0], ((ahead - behind) / (2 * h)).mT, rtol=1e-5, atol=1e-7)


# ---------------------------------------------------------------------- what is refused


@pytest.mark.slow
def test_stiffness_is_searched_too():
    search = Learner(options_for("divergent_field", runs=1, optimizer="lbfgs", updates=1, rollouts=3)).learn()
    assert not torch.equal(search.policy.stiffness_b[0], search.initial.stiffness_b)
    assert search.history.cost[-1][0] < search.history.cost[0][0]


@pytest.mark.slow
def test_a_method_is_any_generator():
    """The interface that a new method has to keep: here, one that stands still."""

    def still(brief):
        z = torch.zeros(brief.runs, brief.P, dtype=torch.float64)
        while True:
            yield Ask(z[None], z)

    task = Short()
    policy = task.policy().expand(3)
    method = Method(still, gradient=False, random=False)
    search = CoordinateSearch(policy, Homogeneous(policy), method, Brief(3, P, 4, 1.0, 0))
    before = policy.pack().detach().clone()
    assert search.step(lambda: task.cost(task.rollout(policy))).shape == (3,)
    assert search.n_rollouts == 4
    torch.testing.assert_close(policy.pack().detach(), before, rtol=0, atol=0)


# ------------------------------------------------------------------ the contract: frozen parameters, failures, all or nothing


def search_of(name, policy):
    brief = Brief(runs=2, P=int(free_entries(policy).sum()), n_rollouts=4, scale=1.0, seed=0)
    return CoordinateSearch(policy, Gaussian(0.1), METHODS[name], brief)


def quadratic(policy):
    return lambda: (policy.pack() - 1.0).square().sum(-1)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
def test_frozen_parameters_stay_and_the_others_learn(name, random_policy):
    policy = random_policy(batch=(2,))
    policy.A.requires_grad_(False)
    search, before = search_of(name, policy), policy.A.detach().clone()
    tried, first = [], policy.b.detach().clone()

    def closure():
        tried.append(policy.A.detach().clone())
        return quadratic(policy)()

    for _ in range(5):
        search.step(closure)
    assert torch.equal(policy.A, before)
    assert all((before == A).all() for A in tried)
    assert (policy.b != first).any()


def test_all_frozen_is_refused(random_policy):
    policy = random_policy(batch=(2,)).requires_grad_(False)
    with pytest.raises(InvalidArgumentError, match="all parameters are frozen"):
        search_of("cma", policy)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.slow
def test_costs_that_are_not_finite_are_failures_and_not_the_best(name, value, random_policy):
    policy = random_policy(batch=(2,))
    search, calls = search_of(name, policy), []

    def closure():
        calls.append(1)
        costs = quadratic(policy)()
        return costs * value if len(calls) in (1, 3) else costs

    failed = 0
    for _ in range(8):
        search.step(closure)
        failed += search.failed
        assert policy.pack().isfinite().all()
    assert failed > 0
    assert all(not answer.cost.isneginf().any() for answer in search._answers)
    assert (search.mean_cost < 1e3).all()


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
def test_a_step_that_raises_is_as_if_it_had_not_been(name, random_policy):
    pair, first = [], random_policy(batch=(2,))
    for fail in (False, True):
        policy = copy.deepcopy(first)
        search, calls = search_of(name, policy), []

        def closure(policy=policy, calls=calls, fail=fail):
            calls.append(1)
            if fail and len(calls) == 7:
                raise KeyboardInterrupt
            return quadratic(policy)()

        n = 0
        while n < 10:
            before = policy.pack().detach().clone()
            try:
                search.step(closure)
                n += 1
            except KeyboardInterrupt:
                assert torch.equal(policy.pack(), before)
        pair.append(policy.pack().detach())
    assert torch.equal(*pair)
