"""Files are whole or not there, and nothing damaged, foreign or absurd is read."""

import errno
import os

import numpy as np
import pytest
import torch

from tests.recorded import write_absurd_npz
from torchds import files
from torchds.errors import FileError

CONTENT = {
    "theta": torch.arange(12, dtype=torch.float64).reshape(3, 4),
    "single": torch.ones(2, dtype=torch.float32),
    "options": {"lr": 0.1, "name": "pibb", "flag": True, "none": None, "n": 3},
    "history": [[1.0, float("inf")], (1, 2)],
}


@pytest.fixture
def saved(tmp_path):
    files.save(tmp_path / "run.pt", "checkpoint", CONTENT)
    return tmp_path / "run.pt"


def test_what_is_saved_comes_back(saved):
    back = files.load(saved, "checkpoint")
    assert (
        list(back) == list(CONTENT) and back["options"] == CONTENT["options"] and back["history"] == CONTENT["history"]
    )
    assert torch.equal(back["theta"], CONTENT["theta"]) and back["single"].dtype == torch.float32


def test_torch_opens_the_file_with_weights_only(saved):
    assert torch.load(saved, weights_only=True)["kind"] == "checkpoint"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_no_flipped_bit_changes_what_is_read(saved, tmp_path, seed):
    """A flip is refused, or it is in padding that nobody reads."""
    raw, rng = saved.read_bytes(), np.random.default_rng(seed)
    for _ in range(50):
        position, bit = int(rng.integers(len(raw))), int(rng.integers(8))
        damaged = bytearray(raw)
        damaged[position] ^= 1 << bit
        (tmp_path / "damaged.pt").write_bytes(damaged)
        try:
            back = files.load(tmp_path / "damaged.pt", "checkpoint")
        except FileError:
            continue
        assert files.digest(back) == files.digest(CONTENT)


def test_a_file_that_was_cut_is_refused(saved, tmp_path):
    raw = saved.read_bytes()
    for n in np.linspace(0, len(raw) - 1, 200).astype(int):
        (tmp_path / "cut.pt").write_bytes(raw[:n])
        with pytest.raises(FileError):
            files.load(tmp_path / "cut.pt", "checkpoint")


def test_another_kind_and_a_later_format_are_refused_by_name(saved, tmp_path):
    with pytest.raises(FileError, match="is a checkpoint, needed is a policy"):
        files.load(saved, "policy")
    later = {**torch.load(saved, weights_only=True), files.SEAL: files.FORMAT + 1}
    torch.save(later, saved)
    with pytest.raises(FileError, match="newer torchds"):
        files.load(saved, "checkpoint")
    torch.save(CONTENT, saved)
    with pytest.raises(FileError, match="not written by this library"):
        files.load(saved, "checkpoint")


def test_nothing_that_is_read_runs_code(tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    torch.save({files.SEAL: 1, "content": Trap()}, tmp_path / "trap.pt")
    with pytest.raises(FileError):
        files.load(tmp_path / "trap.pt", "checkpoint")
    assert not (tmp_path / "sprung").exists()


def test_a_tensor_that_claims_more_than_there_is_is_refused(tmp_path):
    with pytest.raises(FileError, match="claims more"):
        files.save(tmp_path / "big.pt", "checkpoint", {"x": torch.zeros(1).expand(10**12)})


def test_values_that_look_alike_have_digests_of_their_own():
    values = [
        1,
        1.0,
        True,
        "1",
        b"1",
        [1],
        (1,),
        {"a": 1},
        {"a": 1.0},
        None,
        "None",
        torch.ones(1),
        torch.ones(1, 1),
        -0.0,
        0.0,
    ]
    assert len({files.digest({"v": value}) for value in values}) == len(values)
    assert files.digest(["ab", "c"]) != files.digest(["a", "bc"])


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
def test_a_disk_that_refuses_leaves_the_old_file(saved, monkeypatch, code, call):
    before = saved.read_bytes()

    def refuse(*args, **kwargs):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(FileError, match=os.strerror(code)):
        files.save(saved, "checkpoint", {"other": torch.zeros(1)})
    monkeypatch.undo()
    assert saved.read_bytes() == before and list(saved.parent.iterdir()) == [saved]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_disk_that_fills_up_leaves_the_old_file(saved):
    before = saved.read_bytes()

    def fill(stream):
        with open("/dev/full", "wb", buffering=0) as full:
            full.write(b"x")

    with pytest.raises(FileError, match=os.strerror(errno.ENOSPC)):
        files.write_atomically(saved, fill)
    assert saved.read_bytes() == before and list(saved.parent.iterdir()) == [saved]


def test_a_link_is_replaced_and_what_it_led_to_stays(tmp_path):
    (tmp_path / "target").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    files.write_json(tmp_path / "link", {"a": 1})
    assert (tmp_path / "target").read_text() == "precious" and not (tmp_path / "link").is_symlink()


def test_json_has_no_nan(tmp_path):
    files.write_json(tmp_path / "r.json", {"cost": [[1.0, float("nan")], [float("inf")]]})
    assert "NaN" not in (tmp_path / "r.json").read_text()
    assert files.read_json(tmp_path / "r.json") == {"cost": [[1.0, None], [None]]}


@pytest.mark.parametrize("text", ["", "[1, 2]", '{"a": ', "\udcff", "[" * 100_000])
def test_json_that_is_none_is_refused(tmp_path, text):
    (tmp_path / "bad.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(FileError):
        files.read_json(tmp_path / "bad.json")


def test_arrays_come_back_and_damaged_or_absurd_ones_do_not(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, x=np.arange(1000.0))
    assert np.array_equal(files.read_npz(path)["x"], np.arange(1000.0))
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    with pytest.raises(FileError):
        files.read_npz(path)
    write_absurd_npz(path, "x")
    with pytest.raises(FileError, match="claims to unpack to 536870"):
        files.read_npz(path)
    np.savez(path, x=np.array([{}], dtype=object), y=np.ones(2))
    with pytest.raises(FileError):
        files.read_npz(path)
    assert set(files.read_npz(path, ["y", "z"])) == {"y"}


def flipped(raw):
    """All that differ in one bit."""
    for place in range(8 * len(raw)):
        damaged = bytearray(raw)
        damaged[place // 8] ^= 1 << place % 8
        yield damaged


def zeroed(raw):
    """All that a disk has left with zeros from somewhere to the end, or in a block of 16 bytes."""
    for at in range(len(raw)):
        yield raw[:at] + bytes(len(raw) - at)
        yield raw[:at] + bytes(len(raw[at : at + 16])) + raw[at + 16 :]


@pytest.mark.parametrize("damage", [flipped, zeroed])
@pytest.mark.slow
def test_no_damage_of_an_archive_changes_what_is_read_in_silence(damage, tmp_path):
    path, arrays = tmp_path / "a.npz", {"x": np.arange(3.0), "dt": np.array(0.1)}
    files.write_npz(path, arrays)
    for damaged in damage(path.read_bytes()):
        path.write_bytes(damaged)
        try:
            found = files.read_npz(path)
        except FileError:
            continue
        assert found.keys() == arrays.keys() and all(np.array_equal(found[name], arrays[name]) for name in arrays)


def test_an_archive_of_nothing_is_whole(tmp_path):
    files.write_npz(tmp_path / "a.npz", {})
    assert files.read_npz(tmp_path / "a.npz") == {}


def test_what_is_no_file_is_said_to_be_none(tmp_path):
    for name in (tmp_path, tmp_path / "none", tmp_path / ("x" * 300), "a\0b"):
        with pytest.raises(FileError):
            files.existing(name)
