"""When the law is compiled, and what it refuses; that it is right is tested in kernels/test_arm and test_cartesian."""

import pytest
import torch

from tests.torchds.kernels.comparison import needs_numba
from tests.torchds.kernels.test_arm import arms, screws
from torchds.cartesian import CartesianImpedance
from torchds.errors import InvalidArgumentError
from torchds.kernels.choice import has
from torchds.targets import PlaneReference

pytestmark = needs_numba


@pytest.fixture(autouse=True)
def compiled(monkeypatch):
    monkeypatch.delenv("TORCHDS_BACKEND", raising=False)


def reference():
    zero = torch.zeros(2, dtype=torch.float64)
    return PlaneReference(zero, zero[0], zero, zero[0])


def controlled(randn, **options):
    return CartesianImpedance(screws(randn), torch.zeros(7), start_within=None, **options)


def test_a_mass_that_is_none_is_refused(randn):
    q, v, mass, bias = arms(randn, 7, 3)
    mass[1] = -mass[1]
    with pytest.raises(InvalidArgumentError, match="mass has to be symmetric and positive definite"):
        controlled(randn)(q, v, mass, bias, reference(), 100.0)


def test_a_reference_for_other_arms_is_refused(randn):
    state, wrong = arms(randn, 7, 3), PlaneReference(randn(2, 2), randn(2), randn(2, 2), randn(2))
    with pytest.raises(InvalidArgumentError, match=r"has to fit \(3,\) arms, as \(3, 2\), got \(2, 2\)"):
        controlled(randn)(*state, wrong, 100.0)


def test_gradients_go_through_torch(randn):
    q, v, mass, bias = arms(randn, 7, 3)
    q.requires_grad_()
    controlled(randn)(q, v, mass, bias, reference(), 100.0).torque.sum().backward()
    assert float(q.grad.abs().max()) > 0


def test_it_is_compiled_where_it_can_be(randn, monkeypatch):
    from torchds.fused_arm import FusedArm

    assert has("cpu")
    calls = []
    law = FusedArm.__call__
    monkeypatch.setattr(FusedArm, "__call__", lambda self, *rest: calls.append(1) or law(self, *rest))
    state = arms(randn, 7, 2)
    controlled(randn)(*state, reference(), 100.0)
    controlled(randn, backend="eager")(*state, reference(), 100.0)
    assert len(calls) == 1
    single = Single()
    CartesianImpedance(single, torch.zeros(7), start_within=None)  # of float32: torch
    with pytest.raises(InvalidArgumentError, match=r"backend='fused' needs numba .* float64, got one in torch.float32"):
        CartesianImpedance(single, torch.zeros(7), backend="fused")


class Single:
    dtype = torch.float32

    def jacobian(self, th, *, ret_eef_pose):
        return torch.zeros(len(th), 6, 7), torch.eye(4).expand(len(th), 4, 4)
