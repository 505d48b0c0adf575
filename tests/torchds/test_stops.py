"""Stop conditions of the library; the roll-outs that they end are in test_rollouts.py and kernels/."""

import torch

from torchds import Bounds, Walls


def test_bounds_refuse_what_is_outside_or_not_finite():
    x = torch.zeros(4, 2)
    x_next = torch.tensor([[0.5, 0.5], [1.5, 0.0], [torch.nan, 0.0], [0.0, -torch.inf]])
    assert Bounds(-1.0, 1.0)(x, x_next).tolist() == [False, True, True, True]
    assert Bounds(-1.0, torch.tensor([2.0, 1.0]))(x, x_next).tolist() == [False, False, True, True]


def test_a_wall_is_crossed_touched_or_passed():
    wall = Walls(torch.tensor([[[0.0, 0.0], [0.0, 1.0]]]))
    x = torch.tensor([-1.0, 0.5]).expand(4, 2)
    x_next = torch.tensor([[1.0, 0.5], [0.0, 0.5], [-0.5, 0.5], [1.0, 3.0]])
    assert wall(x, x_next).tolist() == [True, True, False, False]
