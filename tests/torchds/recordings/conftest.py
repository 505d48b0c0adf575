import pytest
import scipy.io


@pytest.fixture
def file(tmp_path):
    """Writes a text."""

    def write(text, name="a.csv"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


@pytest.fixture
def mat(tmp_path):
    """Writes a MATLAB file."""

    def write(**contents):
        scipy.io.savemat(tmp_path / "a.mat", contents)
        return tmp_path / "a.mat"

    return write
