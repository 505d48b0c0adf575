"""Recordings and costs as cost terms."""

import pytest
import torch

from tests.torchds.sessions.motions import costs, record, session
from torchds.errors import FileError
from torchds.sessions.evidence import Evidence, near
from torchds.sessions.layout import Layout


@pytest.fixture
def mine(tmp_path):
    made = session(tmp_path / "s")
    made.ask()
    return made


def evidence(mine, states=("there",) * 3):
    return Evidence(mine.trial, mine.update_folder, list(states), mine.references())


@pytest.mark.slow
def test_costs_are_infinite_where_a_roll_out_failed(mine):
    costs(mine, 1.5, "failed", 2.5)
    found = evidence(mine, ("there", "failed", "there"))
    assert found.kind == "costs" and found.costs.tolist() == [1.5, torch.inf, 2.5] and found.questions() == []
    assert found.terms(mine.policy.expand(3))["measured"].tolist() == [1.5, torch.inf, 2.5]


@pytest.mark.slow
def test_recordings_are_those_of_the_files_and_may_start_a_tenth_of_the_motion_away(mine):
    for k in (1, 2, 3):
        record(mine, k)
    asked = mine.references()
    found = evidence(mine)
    assert found.kind == "recordings" and torch.equal(found.recorded.x, asked.x)
    (size, _) = near(mine.trial.layout, asked.x)
    record(mine, 2, lambda x: x + 0.9 * size)
    evidence(mine)
    record(mine, 2, lambda x: x + 1.1 * size)
    with pytest.raises(FileError, match=r"recording-2\.csv: the motion starts at"):
        evidence(mine)


@pytest.mark.slow
@pytest.mark.parametrize("far", [1e6, torch.nan])
def test_what_was_not_asked_for_says_nothing_about_the_start_of_others(mine, far):
    record(mine, 1)
    asked = mine.references()
    size = near(mine.trial.layout, asked.x[[0, 2]])[0]
    asked.x[1, 5:] = far
    mine.trial.reaches = lambda x: (x.abs() < 1e3).all(-1)
    record(mine, 3, lambda x: x + 0.9 * size)
    Evidence(mine.trial, mine.update_folder, ["there", "failed", "there"], asked)
    record(mine, 3, lambda x: x + 1.1 * size)
    with pytest.raises(FileError, match=r"recording-3\.csv: the motion starts at"):
        Evidence(mine.trial, mine.update_folder, ["there", "failed", "there"], asked)


def test_sizes_are_those_of_columns_with_one_unit():
    x = torch.tensor([[[0.0, 0, 0], [2, 1, 0.5]]]).double()
    assert near(Layout(("x [m]", "y [m]", "a [rad]")), x) == pytest.approx((0.2, 0.2, 0.05))
