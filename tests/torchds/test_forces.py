"""Forces of the library at points where they are known."""

import copy

import pytest
import torch
from torch.testing import assert_close

from tests.torchds.kernels.comparison import needs_numba
from torchds import rollout
from torchds.errors import InvalidArgumentError
from torchds.forces import ConstantForce, DivergentForce, SpringForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass


def test_a_constant_force_may_act_beyond_a_border_only():
    push, x = torch.tensor([1.0, 2.0]), torch.tensor([[0.0, 5.0], [1.0, 5.0], [torch.nan, 5.0]])
    assert ConstantForce(push)(0.0, x, x).tolist() == [1.0, 2.0]
    assert ConstantForce(push, border=0.5)(0.0, x, x).tolist() == [[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]]
    assert ConstantForce(push, border=4.0, axis=1)(0.0, x, x).tolist() == [[1.0, 2.0]] * 3


def test_a_divergent_force_leads_away_from_a_path():
    path = torch.stack([torch.arange(5.0), torch.zeros(5)], -1)
    x = torch.tensor([[2.0, 0.5], [2.0, -0.5], [2.25, 1.0]])
    assert_close(DivergentForce(path, 3.0)(0.0, x, x), torch.tensor([[0.0, 1.5], [0.0, -1.5], [0.75, 3.0]]))
    normal = DivergentForce(path, 3.0, along_normal=True)(0.0, x, x)
    assert_close(normal, torch.tensor([[0.0, 1.5], [0.0, -1.5], [0.0, 3.0 * (1 + 0.0625) ** 0.5]]))


def test_a_path_with_normals_is_in_the_plane_and_may_rest():
    x = torch.tensor([[2.0, 0.5], [0.3, -0.5], [1.0, 1.0]])
    path = torch.tensor([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]])
    resting = path[[0, 0, 1, 1, 1, 2, 2]]
    assert_close(*(DivergentForce(each, 3.0, along_normal=True)(0.0, x, x) for each in (resting, path)))
    for wrong in (torch.eye(3), torch.zeros(4, 2)):
        with pytest.raises(InvalidArgumentError, match=r"\(n, 2\) of at least two different points, got"):
            DivergentForce(wrong, 3.0, along_normal=True)
    with pytest.raises(InvalidArgumentError, match="axis has to be one of the 2 of the force, from -2 to 1, got 2"):
        ConstantForce(torch.ones(2), border=0.0, axis=2)


@needs_numba
@pytest.mark.parametrize("force", [ConstantForce([10.0, 0.0], 0.9), DivergentForce([[0.0, 0.1], [0.3, 0.7]], 60.1)])
def test_forces_of_single_precision_are_compiled_in_that_of_the_policy(random_policy, force):
    single = copy.copy(force)
    for name in ("force", "path", "normal"):
        if hasattr(force, name):
            object.__setattr__(single, name, getattr(force, name).float())
    policy = random_policy(Q=1).requires_grad_(False)
    plant = ImpedanceControlled(PointMass(force=single))
    eager, fused = (
        rollout(policy, [[0.9, 0.0], [0.5, 0.2]], 20, 0.05, plant=plant, backend=backend)
        for backend in ("eager", "fused")
    )
    assert_close(fused.x, eager.x, rtol=1e-12, atol=1e-12)


def test_a_spring_pulls_to_its_anchor_as_the_slope_of_its_energy():
    anchor = torch.tensor([1.0, -2.0], dtype=torch.float64)
    x = torch.randn(7, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    energy = 0.5 * 30.0 * (x - anchor).square().sum()
    assert_close(SpringForce(anchor, 30.0)(0.0, x, x), -torch.autograd.grad(energy, x)[0])
    assert SpringForce(anchor.tolist(), 30.0)(0.0, anchor, anchor).tolist() == [0.0, 0.0]
    with pytest.raises(InvalidArgumentError, match=r"anchor has to be .* fit \(3,\), got shape \(2,\)"):
        SpringForce(anchor, 30.0)(0.0, torch.zeros(3), torch.zeros(3))
    with pytest.raises(InvalidArgumentError, match="got -1"):
        SpringForce(anchor, -1.0)
