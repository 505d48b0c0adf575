import pytest

from tests.motions import equal, refuses, two
from torchds.errors import FileError
from torchds.recordings import load, load_npz


def test_a_time_step_that_contradicts_the_file_is_refused(tmp_path):
    two().save_npz(tmp_path / "a.npz")
    assert equal(load_npz(tmp_path / "a.npz", dt=[0.02, 0.05]), two())
    with refuses(FileError, "the file's dt says 0.02 s but the argument dt 0.1 s", "retime()"):
        load_npz(tmp_path / "a.npz", dt=0.1)


@pytest.mark.parametrize(
    ("name", "words"), [("a.npz", ["is no .npz archive", "save_npz()"]), ("a.mat", ["not a readable MATLAB file"])]
)
@pytest.mark.slow
def test_files_that_are_not_what_they_claim(tmp_path, name, words):
    path = tmp_path / name
    for content in (b"time,x\n0,1\n1,2\n", b"", bytes(range(256)) * 10):
        path.write_bytes(content)
        with refuses(FileError, str(path), *words):
            load(path)
    path.unlink()
    with refuses(FileError, str(path), "no such file", "looked in"):
        load(path)


def test_other_kinds_of_file_are_refused(tmp_path):
    (tmp_path / "a.json").write_text("{}")
    with refuses(FileError, "a.json: cannot tell", ".csv, .txt, .npz, .mat and a folder"):
        load(tmp_path / "a.json")
