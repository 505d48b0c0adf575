"""Preselected noise: the choice, its limits, noisy costs, what to deploy, and checkpoints."""

import copy
import pickle

import numpy as np
import pytest
import scipy.stats
import torch
from torch import nn
from torch.testing import assert_close

from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB, SurrogatePIBB
from torchds.optim.regression import Regression
from torchds.optim.surrogate import SURE, _bound

TARGET = torch.linspace(-1.0, 1.0, 6, dtype=torch.float64)
RUNS = 20


def make(batch=(), seed=0, cls=SurrogatePIBB, **options):
    """Six numbers in two parameters, and how far they are from where they should be."""
    a = nn.Parameter(torch.zeros(*batch, 2, 2, dtype=torch.float64))
    b = nn.Parameter(torch.zeros(*batch, 2, dtype=torch.float64))
    options = {
        "n_rollouts": 8,
        "temperature": "capped",
        "elite": "none",
        "generator": torch.Generator().manual_seed(seed),
        **options,
    }
    return cls([a, b], Gaussian(0.2), **options), closure_of([a, b])


def closure_of(params):
    a, b = params
    return lambda: (torch.cat([a.flatten(-2), b], -1) - TARGET).square().sum(-1)


def theta(optim):
    a, b = (p.detach() for p in optim.param_groups[0]["params"])
    return torch.cat([a.flatten(-2), b], -1)


# ------------------------------------------------------------------ the choice


def test_the_first_update_is_that_of_pibb():
    one, other = make((4,)), make((4,), cls=PIBB)
    for optim, closure in (one, other):
        optim.step(closure)
    assert torch.equal(theta(one[0]), theta(other[0]))


def test_as_many_candidates_as_roll_outs_are_all_tried():
    one, other = make((4,), n_candidates=8), make((4,), cls=PIBB)
    for optim, closure in (one, other):
        for _ in range(6):
            optim.step(closure)
    assert_close(theta(one[0]), theta(other[0]), rtol=1e-10, atol=1e-12)  # in another order


def test_what_is_tried_is_cheaper_than_chance():
    """Median over 20 runs of the mean cost of the second update, from the same policies."""
    means = []
    for cls in (SurrogatePIBB, PIBB):
        optim, closure = make((RUNS,), cls=cls)
        optim.step(closure)
        means.append(float(optim.step(closure).median()))
    assert means[0] < 0.9 * means[1]


@pytest.mark.slow
def test_it_needs_fewer_roll_outs_than_pibb():
    """Median of 20 runs, after ten updates."""
    final = []
    for cls in (SurrogatePIBB, PIBB):
        optim, closure = make((RUNS,), cls=cls)
        for _ in range(10):
            optim.step(closure)
        with torch.no_grad():
            final.append(float(closure().median()))
    assert final[0] < 0.5 * final[1]


def test_the_policy_itself_takes_the_place_of_the_last_choice():
    one, other = make(elite="nominal"), make()
    for optim, closure in (one, other):
        optim.step(closure)
    for p, q in zip(one[0].param_groups[0]["params"], other[0].param_groups[0]["params"], strict=True):
        p.data = q.data.clone()
        for name in ("tried", "tried_cost"):
            if name in other[0].state[q]:
                one[0].state[p][name] = other[0].state[q][name].clone()
    costs = []
    for optim, _ in (one, other):
        a, b = optim.ask()
        costs.append((torch.cat([a.flatten(-2), b], -1) - TARGET).square().sum(-1))
    assert_close(costs[0][1:], costs[1][1:], rtol=0, atol=0)
    assert_close(costs[0][0], one[1]().detach(), rtol=0, atol=0)


def test_runs_choose_for_themselves():
    """Runs that start alike and are told opposite costs go opposite ways."""
    optim, _ = make((2,))
    normals = [
        [
            torch.randn(8, 1, *p.shape[1:], dtype=torch.float64).expand(8, *p.shape)
            for p in optim.param_groups[0]["params"]
        ]
    ]
    tried = optim.ask(normals)
    along = tried[1][:, 0, 0]
    optim.tell(torch.stack([along, -along], -1))
    change = (optim.ask()[1] - optim.param_groups[0]["params"][1])[..., 0].detach().mean(0)
    assert change[0] < 0 < change[1]


# ------------------------------------------------------------------ noisy costs


def learned(noise, n_updates=8, **options):
    """Runs with costs to which normals of standard deviation `noise` are added."""
    optim, closure = make((RUNS,), elite="nominal", **options)
    generator = torch.Generator().manual_seed(1)
    for _ in range(n_updates):
        optim.step(lambda: closure() + noise * torch.randn(8, RUNS, dtype=torch.float64, generator=generator))
    return optim, closure


def test_the_policy_itself_is_tried_twice_until_it_is_known_whether_costs_are_exact():
    optim, _ = make((RUNS,), elite="nominal")
    a, b = optim.ask()
    assert not a[:2].any() and not b[:2].any() and a[2:].any()
    exact, _ = learned(0.0)
    known = exact.state[exact.param_groups[0]["params"][0]]
    assert not known["noise_bound"].any() and not known["cost_noise"].any() and not exact.noisy.any()
    assert exact.scalars()["surrogate/noise"] == 0.0
    assert all(e[1].any() for e in exact.ask())  # once was enough
    for done, again in ((4, True), (5, False)):
        asked = learned(0.3, done)[0].ask()
        p = learned(0.3, done)[0].param_groups[0]["params"]
        assert all(torch.equal(e[1], center) == again for e, center in zip(asked, p, strict=True))


def test_pairs_of_costs_bound_the_noise_nineteen_times_out_of_twenty():
    np.testing.assert_allclose(SURE, scipy.stats.chi2.ppf(0.05, range(1, 6)), rtol=1e-4)
    pairs = torch.randn(5, 20000, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 3.0 * 2**0.5
    for n in range(1, 6):
        assert float((_bound(pairs[:n]) > 3.0).double().mean()) == pytest.approx(0.95, abs=0.01)
    one_failed = torch.cat([pairs[:2], torch.full((1, 20000), torch.nan, dtype=torch.float64)])
    assert torch.equal(_bound(one_failed), _bound(pairs[:2]))
    assert _bound(pairs[:0]).isinf().all() and _bound(one_failed[2:]).isinf().all()


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_the_noise_is_found_within_a_factor_of_two(noise):
    """Median over 20 runs, after 80 roll-outs; the policy costs 2.8 at first."""
    optim, _ = learned(noise, n_updates=10)
    assert optim.noisy.all()
    assert noise / 2 < optim.state[optim.param_groups[0]["params"][0]]["cost_noise"].median() < 2 * noise


def test_exploration_is_wider_and_does_not_decay_where_costs_are_noisy():
    spread, ratio = {}, {}
    for noise in (0.0, 1.0):
        optim, _ = learned(noise, n_candidates=8)
        optim.param_groups[0].update(initial_lr=1.0, lr=0.1)  # as a scheduler does
        center = optim.param_groups[0]["params"][1].detach()
        spread[noise] = (optim.ask()[1] - center)[1:].square().mean((0, 2)).sqrt()  # of each run
        ratio[noise] = optim.state[optim.param_groups[0]["params"][0]]["noise_ratio"]
    wider = spread[1.0] / spread[0.0].mean() / 10 / (1 + 0.7 * ratio[1.0].sqrt())
    assert ratio[1.0].min() >= 0.01 and ratio[1.0].max() > 0.1
    assert 0.8 < wider.mean() < 1.2


@pytest.mark.slow
def test_noisy_costs_are_weighed_by_what_similar_policies_cost():
    """With much noise and many roll-outs remembered, predictions lead nearer to the target than measurements."""
    ends = []
    for cls in (SurrogatePIBB, PIBB):
        _, closure = learned(1.0, 30, cls=cls)
        with torch.no_grad():
            ends.append(float(closure().median()))
    assert ends[0] < 0.7 * ends[1]


def test_what_to_deploy_is_the_cheapest_as_far_as_is_known():
    optim, _ = make()
    with pytest.raises(InvalidArgumentError, match=r"recommend\(\) needs roll-outs"):
        optim.recommend()
    optim, _ = learned(0.5, 15)
    before = copy.deepcopy(optim.state_dict())
    a, b = optim.recommend().parameters
    cost = (torch.cat([a.flatten(-2), b], -1) - TARGET).square().sum(-1)
    known = optim.state[optim.param_groups[0]["params"][0]]
    tried = [optim.state[p]["tried"] for p in optim.param_groups[0]["params"]]
    each = (torch.cat([tried[0].flatten(-2), tried[1]], -1) - TARGET).square().sum(-1)
    luckiest = each.take_along_dim(known["tried_cost"].argmin(0, keepdim=True), 0)[0]
    assert cost.median() < luckiest.median()  # than the one that was measured to be cheapest
    found = optim.recommend()
    assert ((found.cost - cost).abs() < 3 * found.standard_error + 0.2).double().mean() > 0.8
    for name, value in before["state"][0].items():
        assert torch.equal(optim.state_dict()["state"][0][name], value)


# ------------------------------------------------------------------ memory and checkpoints


def test_the_memory_holds_the_last_roll_outs():
    optim, closure = make((3,), memory=20)
    for _ in range(4):
        optim.step(closure)
    a, b = optim.param_groups[0]["params"]
    assert optim.state[a]["tried"].shape == (20, 3, 2, 2)
    assert optim.state[a]["tried_cost"].shape == (20, 3)
    expected = (torch.cat([optim.state[a]["tried"].flatten(-2), optim.state[b]["tried"]], -1) - TARGET).square().sum(-1)
    assert_close(optim.state[a]["tried_cost"], expected)


def test_a_policy_that_failed_is_never_recommended():
    optim, closure = make((3,))
    a, b = optim.param_groups[0]["params"]

    def half_fails():
        costs = closure()
        costs[costs < costs.median(0).values] = torch.inf  # the nearer ones
        return costs

    optim.step(half_fails)
    tried = torch.cat([optim.state[a]["tried"].flatten(-2), optim.state[b]["tried"]], -1)
    for present in (True, False):
        found = torch.cat([part.reshape(3, -1) for part in optim.recommend(present=present).parameters], -1)
        same = (tried == found).all(-1)
        assert not (same & optim.state[a]["tried_cost"].isinf()).any()
        assert present or same.any(0).all()


def test_normals_that_are_given_are_tried_as_they_are():
    optim, closure = make()
    optim.step(closure)
    normals = [torch.ones(8, *p.shape, dtype=torch.float64) for p in optim.param_groups[0]["params"]]
    tried = optim.ask([normals])
    assert_close(tried[1], (optim.param_groups[0]["params"][1] + 0.2).expand(8, 2))


def test_failed_updates_leave_no_trace():
    optim, closure = make()
    with pytest.raises(AllRolloutsFailedError):
        optim.step(lambda: closure() * torch.nan)
    assert "tried" not in optim.state[optim.param_groups[0]["params"][0]]
    optim.step(closure)


@pytest.mark.parametrize("elite", ["none", "nominal"])
def test_a_run_that_fails_altogether_at_first_stays_and_learns_later(elite):
    (optim, closure), (other, closure_of_other) = (make((2,), elite=elite) for _ in range(2))
    before = theta(optim)
    optim.step(lambda: torch.stack([torch.full((8,), torch.nan), closure()[:, 1]], -1))
    other.step(closure_of_other)
    assert torch.equal(theta(optim)[0], before[0]) and torch.equal(theta(optim)[1], theta(other)[1])
    for _ in range(40):
        optim.step(closure)
    assert (closure() < 0.1 * (before - TARGET).square().sum(-1)).all()
    assert all(map(np.isfinite, optim.scalars().values()))


@pytest.mark.parametrize(("elite", "told"), [("none", True), ("nominal", False)])
def test_of_two_roll_outs_those_that_were_chosen_tell_how_good_the_prediction_was(elite, told):
    optim, closure = make(elite=elite, n_rollouts=2)
    for _ in range(3):
        optim.step(closure)
    found = optim.scalars()
    assert ("surrogate/error" in found) == told and all(map(np.isfinite, found.values()))


@pytest.mark.parametrize("way", ["state_dict", "pickle", "deepcopy"])
def test_it_resumes_bit_for_bit(way):
    optim, closure = make((2,), memory=20)
    for _ in range(4):
        optim.step(closure)
    if way == "state_dict":
        resumed, again = make((2,), seed=9, memory=20)
        for p, q in zip(resumed.param_groups[0]["params"], optim.param_groups[0]["params"], strict=True):
            p.data = q.data.clone()
        resumed.load_state_dict(copy.deepcopy(optim.state_dict()))
    else:
        resumed = pickle.loads(pickle.dumps(optim)) if way == "pickle" else copy.deepcopy(optim)
        again = closure_of(resumed.param_groups[0]["params"])
    for _ in range(3):
        optim.step(closure)
        resumed.step(again)
    assert torch.equal(theta(resumed), theta(optim))


@pytest.mark.parametrize("options", [{"n_candidates": 7}, {"memory": 0}])
def test_too_few_candidates_or_no_memory_are_refused(options):
    with pytest.raises(InvalidArgumentError, match="n_candidates ≥ n_rollouts and memory ≥ 1 are needed"):
        make(**options)


def test_what_was_predicted_is_said_beside_what_was_measured():
    optim, closure = learned(0.0, 6)
    a, b = (e.detach() for e in optim.ask())
    state = [optim.state[p] for p in optim.param_groups[0]["params"]]
    Z, z = (torch.cat([x.flatten(-2), y], -1) for x, y in ([entry["tried"] for entry in state], (a, b)))
    regression = Regression(Z, state[0]["tried_cost"], ratio=state[0]["noise_ratio"])
    predicted, costs = regression.predict(z)[2:], []
    optim.step(lambda: costs.append(closure()) or costs[0])
    said = optim.scalars()
    assert said["surrogate/length"] == pytest.approx(float(regression.length.mean()))
    assert said["surrogate/predicted_cost"] == pytest.approx(float(predicted.mean()), rel=1e-6)
    error = (predicted - costs[0][2:].detach()).square().mean().sqrt()
    assert said["surrogate/error"] == pytest.approx(float(error), rel=1e-6)
