"""What a task says about itself holds together, and the numbers of the paper are the paper's."""

from dataclasses import FrozenInstanceError

import pytest
import torch

import tasks
from tasks.settings import PAPER_SEARCH, Motion, Regions, Scene, SearchSettings
from torchds import rollout
from torchds.exploration import Homogeneous


@pytest.mark.slow
def test_a_motion_is_what_a_roll_out_takes():
    task = tasks.make("via_point")
    motion = task.motion()
    assert isinstance(motion, Motion) and motion._fields == ("x0", "n_steps", "dt")
    assert rollout(task.policy(), *motion).x.shape == (motion.n_steps + 1, 2)


def test_the_search_of_the_paper_is_that_of_section_33():
    search = PAPER_SEARCH
    assert (search.n_updates, search.n_rollouts, search.control_weight, search.mean_speed) == (50, 10, 5e-4, 0.1)
    assert (search.homogeneous, search.temperature, search.decay, search.elite) == (
        Homogeneous,
        "range",
        "inverse",
        "none",
    )


def test_a_search_without_numbers_leaves_all_sizes_to_the_motion():
    search = SearchSettings()
    assert (search.mean_speed, search.std, search.spread, search.mean_stiffness, search.stiffness_spread) == (None,) * 5
    assert search.control_weight == 0
    with pytest.raises(FrozenInstanceError):
        search.std = 1.0


def test_a_scene_has_no_via_points_walls_or_unit_unless_given():
    scene = Scene(torch.zeros(1, 2), torch.ones(2))
    assert (scene.via_points, scene.walls, scene.regions, scene.unit) == ({}, None, None, "")
    assert scene.obstacles() == []
    assert Scene(torch.zeros(1, 2), torch.ones(2)).via_points is not scene.via_points


def test_the_obstacles_of_a_scene_span_its_walls_and_regions_and_move_with_it():
    regions = Regions(torch.tensor([[1.0, 2.0]]), torch.tensor([0.5]))
    scene = Scene(torch.zeros(1, 2), torch.ones(2), walls=torch.tensor([[[0.0, 0.0], [3.0, 0.0]]]), regions=regions)
    points = torch.cat([track.reshape(-1, 2) for track in scene.obstacles()])
    assert points.amin(0).tolist() == [0, 0] and points.amax(0).tolist() == [3, 2.5]
    assert scene.to(dtype=torch.float64).regions.radii.dtype == torch.float64
