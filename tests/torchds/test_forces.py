"""Forces of the library at points where they are known."""

import pytest
import torch
from torch.testing import assert_close

from torchds.errors import InvalidArgumentError
from torchds.forces import ConstantForce, DivergentForce, SpringForce


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
