"""Descent: the gradients it follows are those of the cost."""

import torch

from train.searchers.coordinates import Answer, Brief
from train.searchers.named import METHODS


def test_finite_differences_follow_a_known_gradient():
    brief = Brief(runs=2, P=3, n_rollouts=5, scale=1.0, seed=0)
    slope = torch.tensor([[1.0, -2.0, 0.0], [0.0, 3.0, -1.0]], dtype=torch.float64)
    asking = METHODS["finite_differences"].begin(brief)
    asked = next(asking)
    after = asking.send(Answer((slope * asked.z).sum(-1), None)).answer
    assert torch.equal(after.sign(), -slope.sign())  # the first step of Adam has the same length in all directions


def test_the_score_function_gradient_points_up_the_slope():
    brief = Brief(runs=20, P=6, n_rollouts=200, scale=0.5, seed=0)
    asking = METHODS["nes"].begin(brief)
    asked = next(asking)
    slope = torch.linspace(-1, 1, 6, dtype=torch.float64)
    step = asking.send(Answer((asked.z * slope).sum(-1), None)).answer
    assert (step[:, [0, -1]].sign() == torch.tensor([1.0, -1.0])).all()
