"""What a file says about a policy beside its field."""

import pytest
import torch

from torchds import files, policy_file
from torchds.errors import FileError, InvalidArgumentError
from torchds.policy_file import Info, completed


def test_what_is_given_takes_the_place_of_what_was_known():
    known = Info(goal=torch.zeros(2), names=("x", "y"), units="m", dt=0.1)
    assert completed(known, 2, None, None, (), "", None) == known
    new = completed(known, 2, [1, 2], torch.eye(2), ("a", "b"), "mm", 1)
    assert new.goal.tolist() == [1.0, 2.0] and new.P.shape == (2, 2) and new[2:5] == (("a", "b"), "mm", 1.0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"goal": torch.zeros(3)}, r"goal has to be finite and end with \(2\), got"),
        ({"goal": [float("nan"), 0.0]}, "goal has to be finite"),
        ({"P": torch.eye(3)}, r"P has to be finite and end with \(2, 2\)"),
        ({"names": ("x",)}, "names has to be one string for each of the 2 inputs"),
        ({"names": "xy"}, "names has to be one string"),
        ({"units": 3}, "units has to be a string such as 'm', got 3"),
        ({"dt": 0.0}, "dt has to be positive"),
    ],
)
def test_what_does_not_fit_is_refused(given, words):
    with pytest.raises(InvalidArgumentError, match=words):
        completed(Info(), 2, **{"goal": None, "P": None, "names": (), "units": "", "dt": None, **given})


def test_tensors_that_share_memory_come_back(tmp_path):
    whole = torch.arange(6.0)
    policy_file.write(
        tmp_path / "p.pt", {"a": whole[2:4], "b": whole.reshape(2, 3).mT, "c": whole[:1].expand(3)}, Info()
    )
    values, info = policy_file.read(tmp_path / "p.pt")
    assert values["a"].tolist() == [2, 3] and values["b"].tolist() == [[0, 3], [1, 4], [2, 5]] and len(values["c"]) == 3
    assert info.goal is None and info.names == () and {"torch", "numpy"} <= set(info.versions)


def test_a_policy_of_another_version_is_refused_by_name(tmp_path):
    files.save(tmp_path / "old.pt", "policy", {"A": torch.ones(1), "b": torch.ones(1)})
    with pytest.raises(FileError, match=r"old.pt is a policy of another version .* write it with policy.save\(path\)"):
        policy_file.read(tmp_path / "old.pt")
