"""Which backend is taken, and what is refused."""

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import DT, T, needs_numba
from torchds import rollout

pytestmark = needs_numba


def refuses(*words):
    return pytest.raises(torchds.errors.InvalidArgumentError, match=".*".join(words))


def test_a_backend_that_cannot_be_had_is_refused(random_policy, randn):
    policy, x0 = random_policy(3), randn(2)
    with refuses("backend has to be", "'best'"):
        rollout(policy, x0, 5, 0.1, backend="best")


def test_the_environment_says_what_auto_means(random_policy, randn, monkeypatch):
    policy, x0 = random_policy(4, batch=(50,)), randn(2)
    with torch.no_grad():
        eager = rollout(policy, x0, T, DT, backend="eager").x
        fused = rollout(policy, x0, T, DT, backend="fused").x
        assert not torch.equal(eager, fused)
        for meaning, expected in (("eager", eager), ("fused", fused), ("auto", fused)):
            monkeypatch.setenv("TORCHDS_BACKEND", meaning)
            assert torch.equal(rollout(policy, x0, T, DT).x, expected)
