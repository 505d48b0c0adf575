"""Preselected noise: predictions against scikit-learn, the choice, its limits, and checkpoints."""

import copy
import pickle

import numpy as np
import pytest
import torch
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF
from torch import nn
from torch.testing import assert_close

from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB, SurrogatePIBB
from torchds.optim.functional import predict_costs

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


# ------------------------------------------------------------------ the prediction


def draw(n, batch=3, F=4, seed=0):
    return torch.randn(n, batch, F, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_predictions_are_those_of_another_implementation():
    tried, candidates = draw(15), draw(40, seed=1)
    costs = tried.square().sum(-1) + tried[..., 0]
    found = predict_costs(tried, costs, candidates, noise=1e-2)
    for run in range(3):
        Z, S = tried[:, run].numpy(), costs[:, run].numpy()
        above = S - S.min()
        cap = min(above.max(), 3 * np.median(above))
        y = np.minimum(above, cap) / cap
        # The median distance, of all pairs and of each with itself; of an odd number of entries.
        scale = np.median(((Z[:, None] - Z) ** 2).sum(-1))
        model = GaussianProcessRegressor(RBF(np.sqrt(scale)), alpha=1e-2, optimizer=None).fit(Z, y - y.mean())
        np.testing.assert_allclose(
            found[:, run].numpy(), model.predict(candidates[:, run].numpy()), rtol=1e-7, atol=1e-9
        )


def test_the_unit_of_the_coordinates_does_not_matter():
    tried, candidates = draw(15), draw(40, seed=1)
    costs = tried.square().sum(-1)
    assert_close(predict_costs(1e3 * tried, costs, 1e3 * candidates), predict_costs(tried, costs, candidates))


def test_failed_roll_outs_are_as_bad_as_the_cap():
    tried, candidates = draw(15), draw(40, seed=1)
    costs = tried.square().sum(-1)
    failing, bad = costs.clone(), costs.clone()
    worst = costs.argmax(0, keepdim=True)
    failing.scatter_(0, worst, torch.nan)
    bad.scatter_(0, worst, 1e9)
    found = predict_costs(tried, failing, candidates)
    assert found.isfinite().all()
    # The median moves by one place when a roll-out is missing; the order of the candidates hardly does.
    known = predict_costs(tried, bad, candidates)
    for run in range(3):
        assert np.corrcoef(found[:, run], known[:, run])[0, 1] > 0.95


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


def test_the_memory_holds_the_last_roll_outs():
    optim, closure = make((3,), memory=20)
    for _ in range(4):
        optim.step(closure)
    a, b = optim.param_groups[0]["params"]
    assert optim.state[a]["tried"].shape == (20, 3, 2, 2)
    assert optim.state[a]["tried_cost"].shape == (20, 3)
    expected = (torch.cat([optim.state[a]["tried"].flatten(-2), optim.state[b]["tried"]], -1) - TARGET).square().sum(-1)
    assert_close(optim.state[a]["tried_cost"], expected)


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
