"""What was asked and told: recordings are questioned, kinds of evidence are not mixed, one process at a time."""

import pytest
import torch

from tests.torchds.sessions.motions import costs, record, session
from torchds.errors import FileError, InvalidArgumentError
from torchds.sessions.trial import TAKEN


@pytest.fixture
def mine(tmp_path):
    made = session(tmp_path / "s", "poses")
    made.ask()
    return made


@pytest.mark.slow
def test_swapped_recordings_are_refused_and_taken_if_one_insists(mine):
    for k, of in ((1, 1), (2, 3), (3, 2)):
        record(mine, k, of=of)
    with pytest.raises(
        FileError, match=r"recording-2 is the motion of rollout-3\.csv.*insist: session\.tell\(force=True\)"
    ):
        mine.tell()
    assert mine.asked and mine.done == 0
    assert "note: recording-2.csv and recording-3.csv: in a wrong order" in str(mine.tell(force=True))


@pytest.mark.slow
def test_missing_roll_outs_wait_or_count_as_failed(mine):
    record(mine, 1)
    record(mine, 3)
    with pytest.raises(InvalidArgumentError, match=r"1, 3 there; 2 missing; nothing is changed\. next: put recording"):
        mine.tell()
    assert mine.tell(missing="failed").failed == 1
    assert mine.history.seconds == 2 * mine.trial.seconds and mine.spent == 3


@pytest.mark.slow
def test_other_words_for_missing_make_no_update(mine):
    costs(mine, 1.0, 2.0)
    for word in ("Wait", "fail", True):
        with pytest.raises(InvalidArgumentError, match=f"missing has to be 'wait' or 'failed', got {word!r}"):
            mine.tell(missing=word)
    assert mine.asked and mine.done == 0


@pytest.mark.slow
def test_terms_with_names_of_the_session_are_refused_before_anything_is_written(mine):
    for k in (1, 2, 3):
        record(mine, k)

    def written():
        return {path: path.read_bytes() for path in mine.folder.rglob("[!.]*") if path.is_file()}

    before, terms = written(), mine.trial.cost_terms
    mine.trial.cost_terms = lambda path: {"control": terms(path)["goal"]}
    with pytest.raises(InvalidArgumentError, match="got 'control'; give them others and tell again"):
        mine.tell()
    assert written() == before
    mine.trial.cost_terms = terms
    assert {*mine.tell().header} - {"goal", "effort"} == {*TAKEN} - {"measured"}


@pytest.mark.slow
def test_kinds_of_evidence_are_not_mixed(mine):
    costs(mine, 1.0, 2.0, 3.0)
    mine.tell()
    mine.ask()
    for k in (1, 2, 3):
        record(mine, k)
    with pytest.raises(
        InvalidArgumentError, match=r"a session is told recordings or costs\.csv all along; here are recordings"
    ):
        mine.tell()


@pytest.mark.slow
def test_a_stale_session_is_told_so(mine, tmp_path):
    stale = session(tmp_path / "s", "poses")
    costs(mine, 1.0, 2.0, 3.0)
    mine.tell()
    with pytest.raises(FileError, match="another process has gone on with the session"):
        stale.tell()


@pytest.mark.slow
def test_the_first_roll_out_is_the_policy_and_what_is_out_of_reach_is_not_given(mine, tmp_path):
    asked = mine.references()
    torch.testing.assert_close(asked.x[0], mine.trial.reference(mine.policy).x)
    assert not torch.equal(asked.x[1], asked.x[0])
    far = asked.x[1, -1, 0]
    other = session(tmp_path / "t", "poses")
    other.trial.reaches = lambda x: (x[..., 0] - far).abs() > 1e-6
    assert other.ask()[4:] == ([2], [])
    folder = other.update_folder
    assert sorted(path.name for path in folder.glob("r*")) == ["recording-2.failed", "rollout-1.csv", "rollout-3.csv"]
