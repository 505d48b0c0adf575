"""What the LASA benchmark measures, on fields whose measures are known."""

import pytest
import torch

from torchds import GMRPolicy
from train.lasa.measures import FIRST, Split, draw, reproduce, share_at_goal, single_motions
from train.lasa.published import PUBLISHED, PUBLISHED_SEDS


def test_there_are_26_single_motions_and_each_has_its_published_error():
    assert len(single_motions()) == 26
    assert set(PUBLISHED_SEDS) == set(single_motions())
    assert sum(PUBLISHED_SEDS.values()) / 26 == pytest.approx(PUBLISHED["SEDS"][0], abs=0.01)


@pytest.mark.slow
def test_repetitions_draw_splits_from_their_seeds():
    demos = [draw(("Worm",), "published", seed).test[0][0].x for seed in (0, 1)]
    assert torch.equal(*demos)
    first, again, second = (draw(("Worm",), "random", seed) for seed in (0, 0, 1))
    assert torch.equal(first.x, again.x)
    assert not torch.equal(first.x, second.x)
    assert len(first.train[0]) == 4
    assert first.x.shape == (1, 3, 500, 2)
    assert len(first.train[0][0].x) == 125


@pytest.mark.slow
def test_the_share_at_the_goal_counts_each_motions_starts():
    """One field ends at the goal, one beside it, one only where x1 > 0 (half of the starts), one runs away."""
    slopes = torch.diag_embed(torch.tensor([[-1.0, -1.0], [-1.0, -1.0], [0.0, -1.0], [1.0, 1.0]])).double()
    offsets = torch.tensor([[0.0, 0.0], [5.0, 0.0], [0.0, 0.0], [0.0, 0.0]]).double()
    gate = torch.ones(4, 1).double(), torch.zeros(4, 1, 2).double(), torch.eye(2).double().expand(4, 1, 2, 2)
    policy = GMRPolicy(*gate, slopes.unsqueeze(1), offsets.unsqueeze(1))
    box = torch.tensor([[-5.0, -10.0], [5.0, 10.0]]).double().unsqueeze(1).expand(2, 4, 2).clone()
    box[0, 2, 0], box[1, 2, 0] = -0.5, 5.5  # x1 from -1.1 to 6.1 in 15 steps of 0.48: four within 1 mm of the goal's x1
    share = share_at_goal(policy, box, torch.zeros(4, 2).double())
    assert share.tolist() == [1.0, 0.0, 4 / 16, 0.0]


def field(slope):
    """v = slope x for one motion."""
    gate = torch.ones(1, 1).double(), torch.zeros(1, 1, 2).double(), torch.eye(2).double().expand(1, 1, 2, 2)
    return GMRPolicy(*gate, slope * torch.eye(2).double().expand(1, 1, 2, 2), torch.zeros(1, 1, 2).double())


def straight(sideways):
    """One motion with one test demonstration: what v = −x does from (-40, 0), moved sideways along the way."""
    steps = torch.arange(500, dtype=torch.float64)
    x = torch.stack([-40 * 0.99**steps, sideways * torch.ones(500, dtype=torch.float64)], -1)
    return Split([], [], x[None, None], torch.zeros(1, 1, 500, 2).double(), torch.zeros(2, 1, 2).double())


@pytest.mark.slow
def test_a_field_that_made_the_demonstration_reproduces_it():
    """Euler steps of 0.01 s of v = −x are the factors 0.99 that the demonstration is made of; both ends stand out."""
    measured = reproduce(field(-1.0), straight(0.0))
    x = 40 * 0.99 ** torch.arange(2000, dtype=torch.float64)
    missing = (x[:FIRST] - x[FIRST]).sum()
    rests = FIRST + int((x[FIRST:] < 0.1).nonzero()[0])  # slower than 0.1 mm/s from here on
    longer = (x[499] - x[500 : rests + 4]).sum()
    assert float(measured["dtwd"]) == pytest.approx(float(missing + longer), rel=1e-6)
    assert float(measured["swept_area"]) == pytest.approx(0.0, abs=0.5)


def test_reproductions_that_go_astray_are_far_from_the_demonstration():
    near, away = (reproduce(field(slope), straight(0.0)) for slope in (-1.0, 1.0))
    for name in ("dtwd", "swept_area"):
        assert away[name].isfinite().all()
    assert away["dtwd"] > 100 * near["dtwd"]
