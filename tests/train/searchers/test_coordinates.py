"""The searchers behind --optimizer: what they spend, where they search, that they improve, repeat and resume."""

import sys
from typing import get_args

import numpy as np
import pytest
import scipy.optimize
import torch

import tasks
from tests.motions import Short
from torchds.errors import InvalidArgumentError, MissingPackageError
from torchds.exploration import Homogeneous, TrajectorySpace
from train.learning.learner import Learner
from train.options import ConstrainedReachingOptions, DivergentFieldOptions, Optimizer, ViaPointOptions
from train.searchers.coordinates import Answer, Ask, Brief, CoordinateSearch, Method, root
from train.searchers.libraries import lockstep
from train.searchers.named import METHODS
from train.searchers.sampled import SAMPLED

GRADIENTS = [name for name, method in METHODS.items() if method.gradient]
P = 24  # of four components in the plane


@pytest.fixture(scope="module")
def task():
    return Short()


def learner(task, name, updates=3, rollouts=5, **options):
    return Learner(ViaPointOptions(runs=2, optimizer=name, updates=updates, rollouts=rollouts, **options), task)


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
def test_all_improve(task, name):
    history = learner(task, name, updates=8 if name in GRADIENTS else 20).learn().history
    assert np.median(history.cost[-1]) < 0.9 * np.median(history.cost[0])


@pytest.mark.parametrize("name", METHODS)
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


def test_every_name_of_the_option_is_one_optimizer():
    assert sorted(get_args(Optimizer)) == sorted([*SAMPLED, *METHODS])


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


def test_coordinates_with_a_goal_keep_it_a_fixed_point():
    options = {"runs": 2, "updates": 2, "rollouts": 5, "shrink": "none", "optimizer": "cma"}
    task = tasks.make("constrained_reaching")
    for exploration in ("stable", "stable-trajectory"):
        search = Learner(ConstrainedReachingOptions(exploration=exploration, **options), task).learn()
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


def test_finite_differences_follow_a_known_gradient():
    brief = Brief(runs=2, P=3, n_rollouts=5, scale=1.0, seed=0)
    slope = torch.tensor([[1.0, -2.0, 0.0], [0.0, 3.0, -1.0]], dtype=torch.float64)
    asking = METHODS["finite_differences"].begin(brief)
    asked = next(asking)
    after = asking.send(Answer((slope * asked.z).sum(-1), None)).answer
    assert torch.equal(after.sign(), -slope.sign())  # the first step of Adam has the same length in all directions


def test_the_score_function_gradient_points_up_the_slope():
    brief = Brief(runs=20, P=6, n_rollouts=200, scale=0.5, seed=0)
    asking = METHODS["nes"].begin(brief)
    asked = next(asking)
    slope = torch.linspace(-1, 1, 6, dtype=torch.float64)
    step = asking.send(Answer((asked.z * slope).sum(-1), None)).answer
    assert (step[:, [0, -1]].sign() == torch.tensor([1.0, -1.0])).all()


def minimum(name, cost, runs, updates, **options):
    """What a method recommends for `cost(z)` `(N, runs)` of z `(N, runs, 4)`."""
    brief = Brief(runs=runs, P=4, n_rollouts=8, scale=1.0, seed=0)
    asking = METHODS[name].begin(brief)
    asked = next(asking)
    for _ in range(updates):
        z = asked.z.clone().requires_grad_()
        value = cost(z)
        (gradient,) = torch.autograd.grad(value[value.isfinite()].sum(), z)
        asked = asking.send(Answer(value.detach(), gradient if METHODS[name].gradient else None))
    return asked.answer


def bowl(z):
    """A quadratic whose minimum is elsewhere for each run."""
    center = torch.arange(z.shape[1], dtype=z.dtype).unsqueeze(-1)
    return (torch.tensor([1.0, 2.0, 4.0, 8.0], dtype=z.dtype) * (z - center).square()).sum(-1)


@pytest.mark.parametrize(("name", "updates", "atol"), [("lbfgs", 60, 1e-6), ("cobyqa", 120, 1e-4), ("cma", 150, 1e-3)])
def test_libraries_find_the_minimum_of_each_run(name, updates, atol):
    found = minimum(name, bowl, 3, updates)
    expected = torch.arange(3, dtype=torch.float64).unsqueeze(-1).expand(3, 4)
    torch.testing.assert_close(found, expected, rtol=0, atol=atol)


def test_cobyqa_tries_what_scipy_tries():
    tried, expected = [], []
    minimum("cobyqa", lambda z: tried.append(z[0, 0].detach().numpy()) or bowl(z), 1, 40)

    def cost(z):
        expected.append(z.copy())
        return float(bowl(torch.from_numpy(z)[None, None]))

    scipy.optimize.minimize(cost, np.zeros(4), method="COBYQA", options={"maxfev": 40, "final_tr_radius": 1e-8})
    np.testing.assert_allclose(tried[:35], expected[:35], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", METHODS)
def test_trials_that_fail_are_survived(name):
    """Half of the space costs infinity, and one of two minima is there."""
    found = minimum(name, lambda z: torch.where(z[..., 0] > 0.9, torch.inf, bowl(z)), 2, 60)
    assert found.isfinite().all()
    if name in ("lbfgs", "cobyqa"):  # the best point tried
        assert (found[:, 0] <= 0.9).all()


def test_an_error_inside_a_library_comes_out():
    def minimise(objective, start):
        objective(start)
        raise ValueError("no step left")

    asking = lockstep(Brief(2, 3, 5, 1.0, 0), minimise)
    next(asking)
    with pytest.raises(ValueError, match="no step left"):
        asking.send(Answer(torch.zeros(1, 2, dtype=torch.float64), None))


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("name", GRADIENTS)
def test_gradients_are_refused_where_there_are_none(name):
    class Rigid(tasks.ViaPoint):
        differentiable = False

    with pytest.raises(
        InvalidArgumentError, match=f"--optimizer {name} needs the gradient of a trial.*without gradients: pibb"
    ):
        learner(Rigid(), name)


@pytest.mark.parametrize(("option", "value"), [("decay", "none"), ("temperature", "capped"), ("elite", "best")])
def test_options_of_sampled_noise_are_refused(task, option, value):
    with pytest.raises(InvalidArgumentError, match=f"--{option} {value} goes with --optimizer pibb"):
        learner(task, "adam", **{option: value})


def test_shrunk_noise_is_refused(task):
    with pytest.raises(InvalidArgumentError, match=r"cannot shrink noise; .*--shrink none"):
        learner(task, "cobyqa", exploration="stable")


@pytest.mark.parametrize("name", ["cma", "cobyqa"])
def test_the_missing_package_is_named(task, name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        MissingPackageError, match=rf"--optimizer {name} needs the package '{name}'.*torchds\[baselines\]"
    ):
        learner(task, name)


def test_stiffness_is_searched_too():
    search = Learner(DivergentFieldOptions(runs=1, optimizer="lbfgs", updates=1, rollouts=3)).learn()
    assert not torch.equal(search.policy.stiffness_b[0], search.initial.stiffness_b)
    assert search.history.cost[-1][0] < search.history.cost[0][0]


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
