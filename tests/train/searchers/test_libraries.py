"""Libraries that know one run at a time: each run finds its own minimum, and failures and errors come out."""

import sys

import numpy as np
import pytest
import scipy.optimize
import torch

from torchds.errors import MissingPackageError
from train.searchers.coordinates import Answer, Brief
from train.searchers.libraries import lockstep
from train.searchers.named import METHODS


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
@pytest.mark.slow
def test_libraries_find_the_minimum_of_each_run(name, updates, atol):
    found = minimum(name, bowl, 3, updates)
    expected = torch.arange(3, dtype=torch.float64).unsqueeze(-1).expand(3, 4)
    torch.testing.assert_close(found, expected, rtol=0, atol=atol)


@pytest.mark.skipif("cobyqa" not in scipy.optimize._minimize.MINIMIZE_METHODS, reason="scipy has COBYQA since 1.14")
@pytest.mark.slow
def test_cobyqa_tries_what_scipy_tries():
    tried, expected = [], []
    minimum("cobyqa", lambda z: tried.append(z[0, 0].detach().numpy()) or bowl(z), 1, 40)

    def cost(z):
        expected.append(z.copy())
        return float(bowl(torch.from_numpy(z)[None, None]))

    scipy.optimize.minimize(cost, np.zeros(4), method="COBYQA", options={"maxfev": 40, "final_tr_radius": 1e-8})
    np.testing.assert_allclose(tried[:35], expected[:35], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
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


@pytest.mark.parametrize("name", ["cma", "cobyqa"])
def test_the_missing_package_is_named(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        MissingPackageError, match=rf"--optimizer {name} needs the package '{name}'.*torchds\[baselines\]"
    ):
        next(METHODS[name].begin(Brief(2, 3, 5, 1.0, 0)))
