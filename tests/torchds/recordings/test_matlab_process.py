"""The program that reads MATLAB files: what it writes is plain, and it ends with a number that says what was wrong."""

import io
import json
import subprocess
import sys

import numpy as np
import pytest
import scipy.io

from torchds.recordings.matlab import CODE


def run(path):
    return subprocess.run([sys.executable, "-P", CODE, path], capture_output=True)


@pytest.mark.slow
def test_what_it_writes_is_plain(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"s": {"x": np.eye(2), "name": "arm"}, "n": 3})
    with np.load(io.BytesIO(run(tmp_path / "a.mat").stdout), allow_pickle=False) as arrays:
        tree = json.loads(arrays["tree"].tobytes())
        assert tree["s"] == {"struct": [["x", {"array": "a0"}], ["name", "arm"]]}
        assert np.array_equal(arrays["a0"], np.eye(2))
        assert arrays[tree["n"]["array"]] == 3


@pytest.mark.slow
def test_how_it_ends(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400))
    assert run(tmp_path / "a.mat").returncode == 3
    (tmp_path / "a.mat").write_bytes(b"nothing of the kind" * 20)
    done = run(tmp_path / "a.mat")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
