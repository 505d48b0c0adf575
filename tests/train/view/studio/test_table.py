"""What is seen of the plane."""

import pytest
import torch

from tests import drawn
from train.view.studio.table import TABLE, near, points, seen, widened


def test_all_places_of_a_problem_count():
    p = drawn.problem(strokes=[], walls=[[[0, 0], [3, 1]]], regions=[{"center": [0, 5], "radius": 1}], goal=[-4, 0])
    places = points(p)
    assert places.amin(0).tolist() == [-4, 0] and places.amax(0).tolist() == [3, 6]
    assert points(drawn.problem(strokes=[], via_points=[])).shape == (0, 2)


def test_what_is_drawn_on_the_table_does_not_move_it():
    for n in range(0, 100, 7):
        assert seen(torch.tensor(drawn.stroke()[:n], dtype=torch.float64).reshape(-1, 3)[:, 1:], TABLE) == TABLE
    assert seen(torch.tensor([[0.3, 0.3]]).double(), TABLE) == TABLE


@pytest.mark.parametrize("scale", [50.0, 0.001])
def test_other_lengths_get_a_table_that_holds_all_of_them_and_stays(scale):
    places = scale * torch.tensor(drawn.stroke(), dtype=torch.float64)[:, 1:]
    window = seen(places, TABLE)
    left, right, low, high = window
    assert (places > torch.tensor([left, low])).all() and (places < torch.tensor([right, high])).all()
    assert right - left < 2 * 1.6 * scale and seen(places, window) == window
    assert seen(torch.zeros(0, 2), window) == TABLE


FIVE = [[2e5, 3e5], [2e5, 3e5 + 1e-9], [2e5 + 1e-9, 3e5], [2e5 + 2e-9, 3e5], [2e5, 3e5 + 2e-9]]


@pytest.mark.parametrize(
    "places", [[[5.0, 0.0]], [[5.0, 0.0]] * 7, [[5.0, 0.0], [5.0, 1e-9]], [[2e5, 3e5], [2e5, 3e5 + 1e-7]], FIVE]
)
def test_few_places_and_those_on_top_of_each_other_have_a_usual_table_around_them(places):
    places = torch.tensor(places, dtype=torch.float64)
    window = seen(places, TABLE)
    left, right, low, high = window
    assert (right - left, high - low) == pytest.approx((2.0, 1.25), abs=1e-6)
    assert ((left + right) / 2, (low + high) / 2) == pytest.approx(places.mean(0).tolist(), abs=1e-6)
    assert seen(places, window) == window


def test_places_on_top_of_each_other_do_not_move_the_table():
    assert seen(torch.zeros(7, 2).double(), TABLE) == TABLE
    before = (10.0, 50.0, -5.0, 20.0)
    assert seen(torch.tensor([[30.0, 0.0]] * 9).double(), before) == before


def test_few_places_far_apart_are_all_on_the_table():
    left, right, low, high = seen(torch.tensor([[0.0, 0.0], [500.0, 3.0]]).double(), TABLE)
    assert left < 0 and right > 500 and low < 0 and high > 3 and right - left < 700


def test_a_wide_table_shows_more_beside_and_a_high_one_above():
    for shape in (0.5, 1.6, 4.0):
        left, right, low, high = widened(TABLE, shape)
        assert (right - left) / (high - low) == pytest.approx(shape)
        assert left <= TABLE[0] and right >= TABLE[1] and low <= TABLE[2] and high >= TABLE[3]


def test_what_is_a_width_away_is_near_and_what_is_farther_is_not():
    for place, expected in {(2.9, 0.0): True, (3.1, 0.0): False, (0.0, -2.6): True, (0.0, -2.7): False}.items():
        assert near(torch.tensor(place), TABLE) is expected
