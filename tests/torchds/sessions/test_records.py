"""What a session says to whoever works in Python; the words of the commands are tested in tests/train/hardware."""

from pathlib import Path

from torchds.sessions.records import History, Status, aligned

FOLDER = Path("monday")


def test_the_status_says_what_to_call():
    history = History()
    history.add(0, {"measured": 1.25, "control": 0.25}, 2)
    status = Status(FOLDER, 1, 3, 8, history, FOLDER / "update-002", None)
    assert history.cost == [[1.5]] and history.terms == {"measured": [[1.25]], "control": [[0.25]]}
    assert str(status).splitlines() == [
        "monday: 1 of 3 updates made, 8 roll-outs spent",
        "cost of the policy as it was tried:",
        "after update  measured  control  cost  failed before",
        "           0      1.25     0.25   1.5              2",
        "next: session.ask()",
    ]
    out = status._replace(states=["there", "missing"])
    assert out.next.endswith("beside the references, then session.tell()")
    assert Status.hint("insist", FOLDER) == "session.tell(force=True)"
    assert Status.hint("export", FOLDER) == "session.export('best.pt')"


def test_terms_that_come_and_go_are_nan_where_they_are_not():
    history = History()
    history.add(0, {"control": 1.0}, 0)
    history.add(8, {"force": 2.0, "control": 1.0}, 0)
    history.add(16, {"force": 3.0}, 0)
    assert str(history.terms) == "{'control': [[1.0], [1.0], [nan]], 'force': [[nan], [2.0], [3.0]]}"
    assert "nan" in str(Status(FOLDER, 3, 3, 24, history, FOLDER / "update-004", None))


def test_numbers_stand_to_the_right():
    assert aligned(["name", "cost"], [["a", 1.23456], ["long", 10.0]]).splitlines() == [
        "name   cost",
        "a     1.235",
        "long     10",
    ]
