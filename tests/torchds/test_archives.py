"""Archives that torch writes and numpy reads alone."""

import json
import zipfile

import numpy as np
import pytest
import torch

from torchds import archives, files
from torchds.errors import FileError

CONTENT = {
    "A": torch.arange(12, dtype=torch.float64).reshape(3, 4),
    "deep": {"single": torch.ones(2, dtype=torch.float32), "none": torch.zeros(0, 3)},
    "names": ["x", "y"],
    "dt": 0.1,
    "goal": None,
}


@pytest.fixture
def saved(tmp_path):
    files.save(tmp_path / "a.pt", "policy", CONTENT, without_torch=True)
    return tmp_path / "a.pt"


def test_numpy_reads_what_torch_wrote(saved):
    back = archives.read(saved, "policy")
    assert list(back) == list(CONTENT) and back["names"] == ["x", "y"] and back["dt"] == 0.1 and back["goal"] is None
    for mine, yours in ((back["A"], CONTENT["A"]), *zip(back["deep"].values(), CONTENT["deep"].values(), strict=True)):
        assert np.array_equal(mine, yours.numpy()) and mine.dtype == yours.numpy().dtype and mine.shape == yours.shape


def test_both_read_the_same_file(saved):
    assert files.digest(files.load(saved, "policy")) == files.digest(CONTENT)
    assert torch.equal(torch.load(saved, weights_only=True)["content"]["A"], CONTENT["A"])


@pytest.mark.parametrize("seed", range(3))
def test_no_flipped_bit_changes_what_is_read(saved, tmp_path, seed):
    raw, rng = saved.read_bytes(), np.random.default_rng(seed)
    for _ in range(60):
        damaged, position = bytearray(raw), int(rng.integers(len(raw)))
        damaged[position] ^= 1 << int(rng.integers(8))
        (tmp_path / "damaged.pt").write_bytes(damaged)
        try:
            back = archives.read(tmp_path / "damaged.pt", "policy")
        except FileError:
            continue
        assert np.array_equal(back["A"], CONTENT["A"].numpy()) and back["dt"] == 0.1


def test_an_array_that_was_exchanged_with_its_checksum_is_refused(saved, tmp_path):
    """A zip's own checksums follow whoever writes it; the digest does not."""
    with zipfile.ZipFile(saved) as archive, zipfile.ZipFile(tmp_path / "b.pt", "w") as other:
        for name in archive.namelist():
            data = archive.read(name)
            other.writestr(name, bytes(len(data)) if name.endswith("data/0") else data)
    with pytest.raises(FileError, match="digest"):
        archives.read(tmp_path / "b.pt", "policy")


def test_files_of_other_kinds_versions_and_without_an_index_are_refused(saved, tmp_path, monkeypatch):
    with pytest.raises(FileError, match="is a policy, needed is a checkpoint"):
        archives.read(saved, "checkpoint")
    files.save(tmp_path / "plain.pt", "policy", CONTENT)
    with pytest.raises(
        FileError, match=r"cannot be read without torch: it was not written as a policy by this version"
    ):
        archives.read(tmp_path / "plain.pt", "policy")
    monkeypatch.setattr(archives, "FORMAT", 7)
    files.save(tmp_path / "later.pt", "policy", CONTENT, without_torch=True)
    monkeypatch.undo()
    with pytest.raises(FileError, match="has format 7, this version reads up to 1; install a newer torchds"):
        archives.read(tmp_path / "later.pt", "policy")
    with pytest.raises(FileError, match="no such file"):
        archives.read(tmp_path / "none.pt", "policy")


@pytest.mark.parametrize(
    "place", [["archive/data/0", "|O8", [2]], ["archive/data/0", "<f8", [10**12]], ["no", "<f8", [1]]]
)
def test_claims_of_an_index_are_not_believed(tmp_path, place):
    index = {archives.SEAL: 1, "kind": "policy", "arrays": [place], "digest": "", "content": json.dumps({"array": 0})}
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("archive/data/0", bytes(16))
        archive.writestr(f"archive/{archives.INDEX}", json.dumps(index))
    with pytest.raises(FileError, match="no readable file of a policy"):
        archives.read(tmp_path / "a.pt", "policy")
