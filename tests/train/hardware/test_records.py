"""What a session says, in words."""

from pathlib import Path

import pytest

from train.hardware.records import Asked, Status, Told, hint
from train.learning.history import History

FOLDER = Path("my session")


@pytest.fixture
def status():
    history = History(rollouts=[0], cost=[[1.5]], terms={"measured": [[1.25]], "control": [[0.25]]}, failed=[2])
    return Status(FOLDER, 1, 3, 8, history, FOLDER / "update-002", None)


def test_what_was_asked_names_the_roll_outs_that_must_not_be_executed():
    said = str(Asked(2, 3, FOLDER / "update-002", 8, [4, 7]))
    assert said.startswith(
        "update 2 of 3, references in my session/update-002: rollout-1.csv is the policy as it is, 2 to 8"
    )
    assert said.splitlines()[1:] == [f"do not execute roll-out {k}: out of reach" for k in (4, 7)]
    said = str(Asked(2, 3, FOLDER / "update-002", 8, [], [2]))
    assert said.splitlines()[1:] == ["roll-out 2 is the first once more: execute both, their costs tell the noise"]


def test_what_was_told_is_a_table_with_a_line_for_each_roll_out():
    told = Told(2, 3, 1, ["rollout", "cost", "state"], [[1, 0.123456, "there"], [2, float("inf"), "failed"]])
    first, *table = str(told).splitlines()
    assert first == "update 2 of 3 is made from 2 roll-outs, 1 failed"
    assert [line.split() for line in table] == [
        ["rollout", "cost", "state"],
        ["1", "0.1235", "there"],
        ["2", "inf", "failed"],
    ]
    assert ", failed" not in str(told._replace(failed=0)).splitlines()[0]


def test_the_status_says_what_was_spent_and_what_to_type(status):
    assert str(status).splitlines() == [
        "my session: 1 of 3 updates made, 8 roll-outs spent",
        "cost of the policy as it was tried:",
        "after update  measured  control  cost  failed before",
        "           0      1.25     0.25   1.5              2",
        "next: python -m train hardware ask 'my session'",
    ]
    assert status._replace(done=3).next == (
        f"all updates are made; the best that was tried: {hint('export', FOLDER)}; the last policy, not tried yet, is in "
        "my session/policy.pt"
    )


def test_the_status_of_roll_outs_that_are_out_says_which_are_missing(status):
    out = status._replace(states=["there", "failed", "there", "missing"])
    assert out.returned == "update 2, roll-outs in my session/update-002: 1, 3 there; 2 failed; 4 missing"
    assert out.returned in str(out)
    assert out.next.startswith("next: put recording-<k>.csv") and out.next.endswith(hint("tell", FOLDER))
    assert out._replace(states=["there"]).next == f"next: {hint('tell', FOLDER)}"
