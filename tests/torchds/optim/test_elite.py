"""The first roll-out of a step: a perturbed policy, the unperturbed one, or the best so far."""

import copy

import pytest
import torch
from torch import nn
from torch.nn.functional import pad

import torchds
from torchds import GMRPolicy, visits
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous
from torchds.optim import PI2, PIBB

N, T, DT = 5, 8, 0.1
START = torch.tensor([-1.0, 0.5], dtype=torch.float64)
SEARCHES = pytest.mark.parametrize("cls", [PIBB, PI2])


def make_policy(batch=()):
    generator = torch.Generator().manual_seed(4)
    shapes = {"means": (3, 2), "A": (3, 2, 2), "b": (3, 2)}
    values = {name: torch.randn(s, dtype=torch.float64, generator=generator) for name, s in shapes.items()}
    identity = torch.eye(2, dtype=torch.float64).repeat(3, 1, 1)
    policy = GMRPolicy(torch.full((3,), 1 / 3, dtype=torch.float64), covariances=identity, **values)
    return policy.expand(*batch) if batch else policy


def make_optimizer(policy, cls, elite, seed=0, **options):
    generator = torch.Generator().manual_seed(seed)
    options = {"n_rollouts": N, "control_weight": 0.01, "generator": generator, **options}
    return cls(policy.parameters(), Homogeneous(policy, 0.2), elite=elite, **options)


def make_closure(policy, cls):
    """The goal's distance, at the end."""

    def closure():
        path = torchds.rollout(policy, START, n_steps=T, dt=DT)
        cost = torchds.costs.goal(path.x, torch.zeros(2, dtype=torch.float64))
        return pad(cost.unsqueeze(-1), (T - 1, 0)) if cls is PI2 else cost

    return closure


def flat(policy, tried):
    values = dict(zip(policy.parameters(), tried, strict=True))
    return policy.pack(lambda p: values[p])


def step(policy, optim, closure=None):
    """One update: the parameters tried (N, *batch, P) and their costs (N, *batch)."""
    tried = flat(policy, optim.ask()).detach()
    optim.step(closure or make_closure(policy, type(optim)))
    return tried, optim.last.cost


@SEARCHES
@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("batched", [True, False])
def test_a_nominal_elite_is_the_unperturbed_policy_in_every_step(cls, batch, batched):
    policy = make_policy(batch)
    optim = make_optimizer(policy, cls, "nominal", batched=batched)
    for _ in range(3):
        before = policy.pack().detach()
        with torch.no_grad():
            expected = make_closure(policy, cls)()
        tried, cost = step(policy, optim)
        assert torch.equal(tried[0], before)
        assert (tried[1:] != before).any(-1).all()
        deviation = before - make_policy().pack().detach()
        control = 0.5 * 0.01 * T * deviation.square().sum(-1)
        total = (expected.sum(-1) if cls is PI2 else expected) + control
        torch.testing.assert_close(cost[0], total, rtol=1e-11, atol=1e-12)


@SEARCHES
@pytest.mark.parametrize("elite", ["nominal", "best"])
def test_the_other_roll_outs_are_those_without_an_elite(cls, elite):
    policies = [make_policy(), make_policy()]
    optims = [make_optimizer(p, cls, e) for p, e in zip(policies, ("none", elite), strict=True)]
    for p, optim in zip(policies, optims, strict=True):
        step(p, optim)
        p.unpack(make_policy().pack())
    tried = [step(p, optim)[0] for p, optim in zip(policies, optims, strict=True)]
    assert torch.equal(tried[0][1:], tried[1][1:])
    assert not torch.equal(tried[0][0], tried[1][0])


@SEARCHES
def test_the_first_step_with_a_best_elite_is_one_without(cls):
    policies = [make_policy(), make_policy()]
    for policy, elite in zip(policies, ("none", "best"), strict=True):
        step(policy, make_optimizer(policy, cls, elite))
    assert torch.equal(policies[0].pack(), policies[1].pack())


@SEARCHES
@pytest.mark.parametrize("batch", [(), (4,), (2, 2)])
def test_a_best_elite_is_the_cheapest_policy_so_far_of_each_run(cls, batch):
    policy = make_policy(batch)
    optim = make_optimizer(policy, cls, "best", control_weight=0.0)
    thetas, costs = [], []  # of all roll-outs
    renewed = 0
    for n_iter in range(6):
        tried, cost = step(policy, optim)
        if n_iter:
            best = torch.cat(costs).argmin(0)  # (*batch)
            expected = torch.cat(thetas).take_along_dim(best[None, ..., None], 0).squeeze(0)
            torch.testing.assert_close(tried[0], expected, rtol=1e-13, atol=1e-14)
            lowest = torch.cat(costs).amin(0)
            torch.testing.assert_close(cost[0], lowest, rtol=1e-11, atol=1e-12)  # tried again, at the same cost
            renewed += int((cost[1:].amin(0) < lowest).sum())
            # Only a cheaper one replaces it; what was tried again differs from it by rounding at most.
            tried, cost = tried[1:], cost[1:]
        thetas.append(tried)
        costs.append(cost)
    assert renewed > 0


def test_the_best_counts_by_the_cost_of_its_day():
    """A noisy cost: the elite costs more when it is tried again, and stays the elite."""
    theta = nn.Parameter(torch.zeros(2, dtype=torch.float64))
    optim = PIBB([theta], Gaussian(0.5), n_rollouts=3, elite="best")
    (first,) = optim.ask()
    optim.tell([5.0, 1.0, 4.0])
    (second,) = optim.ask()
    torch.testing.assert_close(second[0], first[1], rtol=0, atol=1e-15)
    optim.tell([100.0, 50.0, 70.0])
    (third,) = optim.ask()
    torch.testing.assert_close(third[0], first[1], rtol=0, atol=1e-15)
    optim.tell([100.0, 50.0, 0.5])
    torch.testing.assert_close(optim.ask()[0][0], third[2], rtol=0, atol=1e-15)


def test_the_elite_takes_part_in_the_update_with_its_distance_as_noise():
    theta = nn.Parameter(torch.zeros(1, dtype=torch.float64))
    optim = PIBB([theta], Gaussian(1.0), n_rollouts=2, elite="best", eliteness=1e6)  # all weight on the cheaper one
    (first,) = optim.ask([[torch.tensor([[3.0], [-2.0]], dtype=torch.float64)]])
    assert first.tolist() == [[3.0], [-2.0]]
    optim.tell([1.0, 2.0])
    assert theta.item() == 3.0
    theta.data.fill_(0.25)
    (second,) = optim.ask([[torch.tensor([[7.0], [8.0]], dtype=torch.float64)]])
    assert second.tolist() == [[3.0], [8.25]]
    optim.tell([1.0, 2.0])
    assert theta.item() == 3.0


def test_the_control_cost_counts_towards_the_best():
    policy = make_policy()
    optim = make_optimizer(policy, PIBB, "best", seed=1, control_weight=10.0)
    with torch.no_grad():
        policy.b.add_(0.3)
    tried, cost = step(policy, optim)
    assert cost.argmin() != (cost - optim.last.control).argmin()  # a seed for which it makes the difference
    torch.testing.assert_close(flat(policy, optim.ask())[0], tried[cost.argmin()], rtol=1e-13, atol=1e-14)


@SEARCHES
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_a_roll_out_that_fails_never_becomes_the_best(cls, bad):
    policy = make_policy()
    optim = make_optimizer(policy, cls, "best")

    def failing():
        costs = make_closure(policy, cls)()
        costs[cheapest] = bad
        return costs

    probe = make_policy()
    cheapest = int(step(probe, make_optimizer(probe, cls, "none"))[1].argmin())
    tried, cost = step(policy, optim, failing)
    second = torch.where(cost.isfinite(), cost, torch.inf).argmin()
    assert second != cheapest
    torch.testing.assert_close(flat(policy, optim.ask())[0], tried[second], rtol=1e-13, atol=1e-14)


@SEARCHES
def test_a_run_without_any_cost_yet_tries_the_policy_that_it_had(cls):
    runs = make_policy((3,))
    optim = make_optimizer(runs, cls, "best")

    def failing():
        costs = make_closure(runs, cls)()
        costs[:, 1] = torch.nan
        return costs

    tried, cost = step(runs, optim, failing)
    again, found = step(runs, optim)
    torch.testing.assert_close(again[0, 1], make_policy().pack(), rtol=1e-13, atol=1e-14)
    for r in (0, 2):
        torch.testing.assert_close(again[0, r], tried[cost[:, r].argmin(), r], rtol=1e-13, atol=1e-14)
    third = flat(runs, optim.ask())
    torch.testing.assert_close(third[0, 1], again[found[:, 1].argmin(), 1], rtol=1e-13, atol=1e-14)


@SEARCHES
@pytest.mark.parametrize("elite", ["nominal", "best"])
@pytest.mark.parametrize("asked", [False, True])
def test_a_run_continues_from_a_checkpoint_bit_for_bit(tmp_path, cls, elite, asked):
    def make():
        policy = make_policy((2,))
        return policy, make_optimizer(policy, cls, elite)

    whole, resumed = make(), make()
    for _ in range(3):
        step(*whole)
    if asked:
        whole[1].ask()
    torch.save([part.state_dict() for part in whole], tmp_path / "run.pt")
    step(*resumed)  # whatever stood there is overwritten
    for part, state in zip(resumed, torch.load(tmp_path / "run.pt", weights_only=True), strict=True):
        part.load_state_dict(state)
    for policy, optim in (whole, resumed):
        for _ in range(3):
            optim.step(make_closure(policy, cls))
    assert torch.equal(whole[0].pack(), resumed[0].pack())
    assert all(map(torch.equal, whole[1].last, resumed[1].last))


@SEARCHES
def test_a_deep_copy_knows_its_best(cls):
    policy = make_policy()
    optim = make_optimizer(policy, cls, "best")
    step(policy, optim)
    twin, twin_optim = copy.deepcopy((policy, optim))
    step(policy, optim)
    step(twin, twin_optim)
    assert torch.equal(policy.pack(), twin.pack())


@SEARCHES
@pytest.mark.parametrize(
    ("elite", "n_rollouts", "message"),
    [
        ("worst", 5, "elite has to be 'none', 'nominal' or 'best', got 'worst'"),
        (True, 5, "elite has to be 'none', 'nominal' or 'best', got True"),
        ("best", 1, "elite='best' needs n_rollouts ≥ 2, got 1"),
        ("nominal", 1, "elite='nominal' needs n_rollouts ≥ 2, got 1"),
    ],
)
def test_elites_that_make_no_sense_are_refused(cls, elite, n_rollouts, message):
    with pytest.raises(InvalidArgumentError, match=message):
        make_optimizer(make_policy(), cls, elite, n_rollouts=n_rollouts)


def test_the_elite_of_a_foreign_simulator_is_among_what_it_is_asked():
    policy = make_policy()
    optim = make_optimizer(policy, PIBB, "nominal")
    trial = policy.expand()
    before = policy.pack().detach()
    trial.unpack(flat(policy, optim.ask()))
    with visits.listen() as seen, torch.no_grad():
        costs = make_closure(trial, PIBB)()
    optim.tell(costs, [visits.Visit(policy, seen[0].features)])
    assert torch.equal(trial.pack()[0], before)
    assert optim.last.cost[0] == costs[0]  # at the demonstrated policy control costs nothing
