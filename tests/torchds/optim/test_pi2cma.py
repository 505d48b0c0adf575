"""PI2-CMA: the covariance against a loop in numpy, its limits, and checkpoints."""

import copy
import pickle

import numpy as np
import pytest
import torch
from torch import nn
from torch.testing import assert_close

from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PI2CMA, PIBB
from torchds.optim.functional import cost_weights

SCALES = torch.tensor([1.0, 10.0, 100.0], dtype=torch.float64)
RUNS = 20


def make(batch=(), seed=0, cls=PI2CMA, **options):
    """Two parameters of three numbers in all, and a quadratic that is steeper in each."""
    a = nn.Parameter(torch.ones(*batch, 2, dtype=torch.float64))
    b = nn.Parameter(torch.ones(*batch, 1, dtype=torch.float64))
    options = {"n_rollouts": 6, "generator": torch.Generator().manual_seed(seed), **options}
    optim = cls([a, b], Gaussian([0.3, 0.1]), **options)
    return optim, lambda: (SCALES * torch.cat([a, b], -1).square()).sum(-1)


def theta(optim):
    return torch.cat([p.detach() for p in optim.param_groups[0]["params"]], -1)


def covariance(optim):
    return optim.state[optim.param_groups[0]["params"][0]]["covariance"]


def test_the_covariance_is_the_average_of_the_outer_products():
    """Two updates of a batch of three runs, with given normals, against a loop over runs and roll-outs."""
    optim, _ = make((3,), rate=0.4, lr=0.5)
    generator = np.random.default_rng(0)
    expected, center = np.stack([np.eye(3)] * 3), theta(optim).numpy()
    for _ in range(2):
        z, costs = generator.standard_normal((6, 3, 3)), generator.random((6, 3))
        optim.ask([[torch.from_numpy(z[..., :2]), torch.from_numpy(z[..., 2:])]])
        optim.tell(torch.from_numpy(costs))
        weights = cost_weights(torch.from_numpy(costs)).numpy()
        for run in range(3):
            drawn = z[:, run] @ np.linalg.cholesky(expected[run]).T
            center[run] += weights[:, run] @ (0.5 * np.array([0.3, 0.3, 0.1]) * drawn)
            moment = sum(w * np.outer(row, row) for w, row in zip(weights[:, run], drawn, strict=True))
            expected[run] = 0.6 * expected[run] + 0.4 * moment
        np.testing.assert_allclose(theta(optim).numpy(), center, rtol=1e-12)
        np.testing.assert_allclose(covariance(optim).numpy(), expected, rtol=1e-10, atol=1e-14)


def test_without_a_rate_it_is_pibb_bit_for_bit():
    one, other = make((4,), rate=0.0), make((4,), cls=PIBB)
    for optim, closure in (one, other):
        for _ in range(5):
            optim.step(closure)
    assert torch.equal(theta(one[0]), theta(other[0]))


def test_eigenvalues_stay_above_the_bound():
    optim, closure = make((5,), rate=1.0, lower_bound=0.02)  # six outer products, a few of which have weight
    for _ in range(10):
        optim.step(closure)
        assert (torch.linalg.eigvalsh(covariance(optim)) > 0.02 * (1 - 1e-9)).all()


def test_the_covariance_of_a_run_that_failed_stays():
    optim, closure = make((2,), rate=0.5)
    optim.step(closure)
    before = covariance(optim).clone()
    optim.step(lambda: closure() * torch.tensor([1.0, torch.nan]))
    assert not torch.equal(covariance(optim)[0], before[0])
    assert_close(covariance(optim)[1], before[1], rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_steep_directions_get_less_noise():
    """Median of 20 runs: after learning, noise is ordered as the costs are."""
    optim, closure = make((RUNS,), n_rollouts=12, rate=0.2)
    for _ in range(40):
        optim.step(closure)
    sizes = covariance(optim).diagonal(dim1=-2, dim2=-1) * torch.tensor([0.3, 0.3, 0.1]).square()
    gentle, middle, steep = sizes.median(0).values
    assert gentle > 3 * middle
    assert middle > 3 * steep


@pytest.mark.slow
def test_without_decay_it_ends_below_pibb():
    """Median of 20 runs."""
    final = []
    for cls in (PI2CMA, PIBB):
        optim, closure = make((RUNS,), n_rollouts=12, cls=cls)
        for _ in range(60):
            optim.step(closure)
        with torch.no_grad():
            final.append(float(closure().median()))
    assert final[0] < 0.1 * final[1]


def test_the_nominal_roll_out_has_no_noise_and_no_part_in_the_covariance():
    optim, _ = make(elite="nominal", rate=1.0)
    assert_close(torch.cat([part[0] for part in optim.ask()]), theta(optim))
    optim.tell(torch.tensor([0.0, *[1e9] * 5], dtype=torch.float64))  # all the weight, but for e^-10 of it
    assert torch.linalg.eigvalsh(covariance(optim)).max() < 0.01


@pytest.mark.parametrize("way", ["state_dict", "between ask and tell", "pickle", "deepcopy"])
def test_it_resumes_bit_for_bit(way):
    def finish(optim, closure, asked):
        if asked:
            optim.tell(torch.arange(6.0, dtype=torch.float64)[:, None].expand(6, 2))
        for _ in range(3):
            optim.step(closure)
        return theta(optim), covariance(optim)

    optim, closure = make((2,))
    for _ in range(3):
        optim.step(closure)
    asked = way == "between ask and tell"
    if asked:
        optim.ask()
    if way in ("pickle", "deepcopy"):
        again = pickle.loads(pickle.dumps(optim)) if way == "pickle" else copy.deepcopy(optim)
        params = again.param_groups[0]["params"]
        resumed = again, lambda: (SCALES * torch.cat(params, -1).square()).sum(-1)
    else:
        resumed = make((2,), seed=9)
        for p, q in zip(resumed[0].param_groups[0]["params"], optim.param_groups[0]["params"], strict=True):
            p.data = q.data.clone()
        resumed[0].load_state_dict(copy.deepcopy(optim.state_dict()))
    for expected, found in zip(finish(optim, closure, asked), finish(*resumed, asked), strict=True):
        assert torch.equal(found, expected)


@pytest.mark.parametrize("options", [{"rate": 1.5}, {"rate": -0.1}, {"lower_bound": 0.0}, {"lower_bound": 2.0}])
def test_numbers_out_of_range_are_refused(options):
    with pytest.raises(InvalidArgumentError, match=rf"{next(iter(options))} has to be in [\[(]0, 1\], got"):
        make(**options)


def test_the_best_so_far_is_refused():
    with pytest.raises(InvalidArgumentError, match="elite of PI2CMA has to be 'none' or 'nominal', got 'best'"):
        make(elite="best")
