"""What was given out is neither replaced nor changed; more of it is tried in tests/faults."""

import pytest

from torchds.errors import FileError, InvalidArgumentError
from torchds.sessions import given

TEXTS = {"rollout-1.csv": "time [s]\n0\n", "recording-2.failed": "out of reach\n"}


def test_given_twice_it_stays_and_of_another_id_it_is_refused(tmp_path):
    folder = tmp_path / "update-001"
    for _ in range(2):
        given.give(folder, "1234", TEXTS)
    given.check_given(folder, "1234")
    with pytest.raises(FileError, match="references that this session did not give out; it is at 5678, they are 1234"):
        given.give(folder, "5678", TEXTS)
    (folder / "rollout-1.csv").write_text("changed\n")
    with pytest.raises(FileError, match="was changed since it was given out"):
        given.check_given(folder, "1234")


def test_what_is_gone_comes_back_with_other_last_digits_and_nothing_else_changes(tmp_path):
    """As another processor computes them: what is there stays, and what was never given is not."""
    folder = tmp_path / "update-001"
    given.give(folder, "1234", {**TEXTS, "rollout-3.csv": "time [s]\n0.1\n"})
    (folder / "rollout-3.csv").unlink()
    other = {name: text.replace("0", "1e-17") for name, text in TEXTS.items()}
    given.give(
        folder, "1234", {**other, "rollout-3.csv": "time [s]\n0.1000001\n", "recording-3.failed": "out of reach\n"}
    )
    assert (folder / "rollout-1.csv").read_text() == TEXTS["rollout-1.csv"]
    assert (folder / "rollout-3.csv").read_text() == "time [s]\n0.1000001\n"
    assert not (folder / "recording-3.failed").exists()
    assert given.check_given(folder, "1234").keys() == {*TEXTS, "rollout-3.csv"}


def test_what_lies_there_before_anything_was_asked_is_named(tmp_path):
    (tmp_path / "costs.csv").write_text("rollout,cost\n")
    with pytest.raises(FileError, match=r"has costs\.csv before anything was asked"):
        given.give(tmp_path, "1234", TEXTS)


@pytest.mark.parametrize(
    ("name", "words"), [("session.pt", "a session already; go on"), ("checkpoint.pt", "holds a run")]
)
def test_a_folder_that_is_used_takes_no_session(tmp_path, name, words):
    given.refuse_used(tmp_path, "go on")
    (tmp_path / name).touch()
    with pytest.raises(InvalidArgumentError, match=words):
        given.refuse_used(tmp_path, "go on")
