"""Descent: the gradients it follows are those of the cost."""

import pytest
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


def tried(cost, n, noisy=False):
    """What Adam tries on cost(z), and what it recommends in the end."""
    asking = METHODS["adam"].begin(Brief(runs=1, P=1, n_rollouts=5, scale=1.0, seed=0, noisy=noisy))
    asked, points = next(asking), []
    for _ in range(n):
        z = asked.z.clone().requires_grad_()
        value = cost(z).sum(-1)
        points.append(float(asked.z))
        asked = asking.send(Answer(value.detach(), torch.autograd.grad(value.sum(), z)[0]))
    return points, float(asked.answer)


def test_adam_recommends_the_cheapest_point_tried_or_the_present_one_where_costs_are_noisy():
    """Its step of 0.25 goes 0, 0.25, 0.5; the cheapest is 0.05 from the minimum."""
    points, recommended = tried(lambda z: (z - 0.3).abs(), 3)
    assert points == pytest.approx([0.0, 0.25, 0.5], abs=1e-6)
    assert recommended == pytest.approx(0.25, abs=1e-6)
    assert abs(tried(lambda z: (z - 0.3).abs(), 3, noisy=True)[1] - 0.3) > 0.1


def test_adam_goes_back_to_the_cheapest_point_with_half_the_step():
    """A slope that begins with a step upwards: nothing is as cheap as where it began."""
    points, recommended = tried(lambda z: torch.where(z < 0, 99.0 + z, z), 90)
    back = [i for i, z in enumerate(points) if z == 0]
    assert back == [0, 41, 81]  # the first one is cheaper than none
    assert [points[i + 1] for i in back] == pytest.approx([-0.25, -0.125, -0.0625], abs=1e-6)
    assert recommended == 0.0
