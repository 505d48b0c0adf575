"""Problems that nothing was tuned on: the rule of the via-points, units that do not matter, and the ball in the way."""

import pytest
import torch

import tasks
from tasks.transfer import ASIDE, PLACES, TRANSFER, UNITS, Reach, beside
from torchds.errors import InvalidArgumentError


def test_via_points_lie_beside_a_motion_on_alternating_sides():
    x = torch.stack([torch.linspace(0, 3, 301), torch.zeros(301)], -1).double()
    points = beside(x, 0.5)
    torch.testing.assert_close(points[:, 0], 3 * torch.tensor(PLACES).double(), rtol=0, atol=0.011)
    assert points[:, 1].tolist() == [0.5, -0.5, 0.5, -0.5]


@pytest.mark.parametrize("letter", ["G", "S", "W"])
@torch.no_grad()
def test_the_unit_of_a_letter_does_not_matter(letter):
    costs, ways = {}, {}
    for unit, size in UNITS.items():
        task = tasks.make("tasks.transfer:Letter", letter=letter, unit=unit)
        path = task.rollout(task.policy())
        costs[unit], ways[unit] = task.cost(path), path.x / size
        away = (path.x[:, None] - task.via_points).norm(dim=-1).amin(0)
        assert (away < 1.01 * ASIDE * task.extent).all() and (away > 0.3 * ASIDE * task.extent).any()
    for unit in ("m", "4 mm"):
        torch.testing.assert_close(ways[unit], ways["mm"], rtol=1e-6, atol=1e-4)
        torch.testing.assert_close(costs[unit], costs["mm"], rtol=1e-5, atol=0)


@torch.no_grad()
def test_the_demonstrated_reach_runs_through_the_ball():
    task = tasks.make("tasks.transfer:Reach")
    path = task.rollout(task.policy())
    terms = task.cost_terms(path)
    assert path.x.shape[-1] == 3 and path.x[-1].norm() < 0.05
    inside = (path.x[1:] - torch.tensor(Reach.center)).norm(dim=-1) < Reach.radius
    assert 5 < inside.sum() < 100 and terms["ball"] > 5 * (terms["goal"] + terms["acceleration"])


def test_every_problem_can_be_made_and_others_are_refused():
    assert len(TRANSFER) == 10
    for spec, options in TRANSFER.values():
        assert tasks.make(spec, **options).name in ("letter", "reach")
    with pytest.raises(InvalidArgumentError, match="letter has to be G, S, W"):
        tasks.make("tasks.transfer:Letter", letter="N")
