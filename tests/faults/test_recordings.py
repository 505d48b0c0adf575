"""Recordings damaged in every way that was thought of: read to finite numbers, or refused in our words, and in two seconds."""

import faulthandler
import io
import os
import signal
import subprocess
import sys
import tempfile
import warnings

import numpy as np
import pytest
import scipy.io
from hypothesis import strategies as st

from tests.faults.cases import CASES, TRIED, fuzz
from torchds import Demonstrations, load
from torchds.errors import FileError, TorchdsError
from torchds.recordings import matlab_process
from torchds.recordings.matlab import restore
from torchds.recordings.matlab_process import plain

N = 12
TIMES = [0.01 * k for k in range(N)]
X = np.stack([np.sin(0.2 * np.arange(N)), 0.05 * np.arange(N)], -1)

CELLS = [
    *[
        "",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-1e308",
        "1e-320",
        "0",
        "abc",
        '"',
        "1_000",
        "0x10",
        "²",
        "1;2",
        "#",
        "--",
        "٣",
    ],
    *["1,5", "\x00", "9" * 400],
]
NAMES = [
    *[
        "t",
        "time",
        "%time",
        "# time",
        "timestamp",
        "secs",
        "nsecs",
        "time_ms",
        "time [s]",
        "x",
        "y",
        "z",
        "x [mm]",
        "vx",
    ],
    *[
        "x_dot",
        "dx/dt",
        "v_y",
        "fx",
        "qx",
        "qw",
        "seq",
        "demo",
        "id",
        "stiffness",
        "s_x",
        "s_1",
        "m_x",
        "[s]",
        "()",
        "é",
    ],
    *["foo", "1", "", "x" * 300],
]
SEPARATORS = [",", ";", "\t", " ", ", ", "|", "  "]
OPTIONS = {
    "dt": [None, 0.01, -1.0, 0.0, float("nan")],
    "time": [None, "t", "time", 0, 9],
    "time_unit": [None, "ms", "ns", "s"],
    "positions": [None, "x", ("x", "y"), (1, 2), (), ("x", "x")],
    "velocities": [None, (), ("vx", "v_y"), "x"],
    "ignore": [None, "y", ("seq", "demo")],
    "resample": [False, True, 0.02, 1e-12],
    "duplicates": ["refuse", "drop"],
    "split": [None, True, False, "demo"],
}
some_options = st.fixed_dictionaries({}, optional={key: st.sampled_from(values) for key, values in OPTIONS.items()})


def is_read_or_refused(path, **options):
    """What comes out is finite everywhere and says its time step; what does not is of our family, and one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            demos = load(path, **options)
        except TorchdsError as error:
            assert "\n" not in str(error)
            return
    assert isinstance(demos, Demonstrations)
    for d in demos:
        assert d.x.isfinite().all() and d.v.isfinite().all() and 0 < d.dt < float("inf")
        assert d.stiffness is None or d.stiffness.isfinite().all()
    demos.check()


@st.composite
def tables(draw):
    """A good table with a few faults: cells, columns, rows, separators, stamps, bytes."""
    n_columns = draw(st.integers(1, 6))
    names = draw(st.lists(st.sampled_from(NAMES), min_size=n_columns, max_size=n_columns))
    names[:3] = draw(st.sampled_from([names[:3], ["time", "x", "y"][:n_columns]]))
    columns = [TIMES, *X.T.tolist(), *[[0.5 * k for k in range(N)]] * 3][:n_columns]
    rows = [[f"{value:.6g}" for value in row] for row in zip(*columns, strict=True)]
    for _ in range(draw(st.integers(0, 4))):
        row, column = draw(st.integers(0, N - 1)), draw(st.integers(0, n_columns - 1))
        rows[row][column] = draw(st.sampled_from(CELLS))
    fault = draw(st.sampled_from(["none", "short", "double", "shuffled", "turned", "blank", "comment", "one", "empty"]))
    at = draw(st.integers(0, N - 1))
    if fault == "short":
        rows[at] = rows[at][:-1]
    elif fault == "double":
        rows.insert(at, list(rows[at]))
    elif fault == "shuffled":
        rows = rows[at:] + rows[:at]
    elif fault == "turned":
        rows = rows[::-1]
    elif fault == "one":
        rows = rows[:1]
    elif fault == "empty":
        rows = []
    separator = draw(st.sampled_from(SEPARATORS))
    lines = [separator.join(names), *(separator.join(row) for row in rows)]
    if draw(st.booleans()) and fault == "none":
        lines = lines[1:]
    if fault in ("blank", "comment"):
        lines.insert(at, {"blank": "", "comment": "# a pause, by hand"}[fault])
    return draw(st.sampled_from(["\n", "\r\n"])).join(lines)


@fuzz(usual=60, text=tables(), options=some_options, suffix=st.sampled_from(["csv", "txt"]))
@pytest.mark.slow
def test_mutated_tables(tmp_path, text, options, suffix):
    path = tmp_path / f"a.{suffix}"
    path.write_text(text)
    is_read_or_refused(path, **options)


@fuzz(usual=40, text=st.text(max_size=300))
@pytest.mark.slow
def test_any_text(tmp_path, text):
    (tmp_path / "a.csv").write_bytes(text.encode("utf-8", "surrogatepass"))
    is_read_or_refused(tmp_path / "a.csv", dt=0.1)


@fuzz(usual=40, content=st.binary(max_size=400), suffix=st.sampled_from(["csv", "txt", "npz"]))
def test_any_bytes(tmp_path, content, suffix):
    (tmp_path / f"a.{suffix}").write_bytes(content)
    is_read_or_refused(tmp_path / f"a.{suffix}")


KEYS = [
    "x0",
    "x1",
    "v0",
    "t0",
    "dt",
    "names",
    "units",
    "demo0_x",
    "demo0_v",
    "demo1_x",
    "x",
    "t",
    "stiffness0",
    "other",
    "dt0",
]
NUMBERS = [0.0, 1.0, -1.0, float("nan"), float("inf"), 1e308, 1e-320, 1e18]


@st.composite
def arrays(draw):
    """Arrays of all shapes and kinds, most of them filled with a motion."""
    kind = draw(
        st.sampled_from(["motion", "motion", "motion", "stamps", "number", "odd", "text", "complex", "whole", "cube"])
    )
    if kind == "motion":
        value = X.copy()
        if draw(st.booleans()):
            value[draw(st.integers(0, N - 1)), 0] = draw(st.sampled_from(NUMBERS))
        return value if draw(st.booleans()) else value.T
    if kind == "stamps":
        return np.array(TIMES) * draw(st.sampled_from([1.0, 1e3, 1e9, -1.0]))
    if kind == "number":
        return np.array(draw(st.sampled_from(NUMBERS)))
    if kind == "odd":
        return np.zeros(draw(st.sampled_from([(0,), (0, 2), (2, 0), (1, 1), (1, 2), (3, 3), (N, 1), (2, 2, 2, 2)])))
    if kind == "text":
        return np.array(draw(st.sampled_from([["a", "b"], ["m", "m"], [""], "fast"])))
    if kind == "complex":
        return X + 1j
    if kind == "whole":
        return np.arange(2 * N).reshape(N, 2).astype(draw(st.sampled_from(["int8", "uint8", "int64", "bool"])))
    cube = np.stack([X, X])
    cube[:, draw(st.integers(0, N)) :] = np.nan
    return cube


ARRAY_OPTIONS = {
    **{key: OPTIONS[key] for key in ("dt", "time_unit", "resample", "duplicates")},
    "split": [None, True, False],
    "time_axis": [None, 0, 1, 2],
    "demo_axis": [None, 0, 1, 2],
    "positions": [None, (0, 1), (0,), "x0", "other"],
    "time": [None, 0, "t0"],
}
array_options = st.fixed_dictionaries({}, optional={key: st.sampled_from(v) for key, v in ARRAY_OPTIONS.items()})


@fuzz(usual=60, contents=st.dictionaries(st.sampled_from(KEYS), arrays(), max_size=5), options=array_options)
@pytest.mark.slow
def test_mutated_archives(tmp_path, contents, options):
    np.savez(tmp_path / "a.npz", **contents)
    is_read_or_refused(tmp_path / "a.npz", **options)


def nested(inner):
    """Cells and structs of what is inside."""
    cells = st.lists(inner, min_size=1, max_size=3)
    return cells | st.dictionaries(
        st.sampled_from(["x", "pos", "vel", "t", "dt", "pose", "arm"]), inner, min_size=1, max_size=3
    )


def as_matlab(value):
    """Lists as cells."""
    if isinstance(value, dict):
        return {key: as_matlab(item) for key, item in value.items()}
    if not isinstance(value, list):
        return value
    cell = np.empty((1, len(value)), dtype=object)
    for i, item in enumerate(value):
        cell[0, i] = as_matlab(item)
    return cell


@fuzz(
    usual=60,
    contents=st.dictionaries(
        st.sampled_from([*KEYS[:6], "demos"]), st.recursive(arrays(), nested, max_leaves=4), max_size=3
    ),
    options=array_options,
)
@pytest.mark.slow
def test_mutated_matlab_files(tmp_path, monkeypatch, contents, options):
    """Read in this process, which writes them itself; the other process costs a second each."""
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {key: as_matlab(value) for key, value in contents.items()})
    parts: dict = {}
    variables = scipy.io.loadmat(buffer)
    tree = {key: plain(value, parts) for key, value in variables.items() if not key.startswith("__")}
    found = {key: restore(value, parts) for key, value in tree.items()}
    monkeypatch.setattr("torchds.recordings.mat.read_variables", lambda path: found)
    (tmp_path / "a.mat").touch()
    is_read_or_refused(tmp_path / "a.mat", **options)


def in_a_fork(command, *, timeout, **_):
    """What `subprocess.run` gives, of a fork of this process, which has imported all that the reader of MATLAB files needs."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        pid = os.fork()
        if pid == 0:
            faulthandler.disable()
            sys.stdout, sys.stderr = io.TextIOWrapper(out), io.TextIOWrapper(err)
            signal.alarm(int(timeout))
            warnings.simplefilter("ignore")
            code = matlab_process.main(command[-1])
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        _, status = os.waitpid(pid, 0)
        out.seek(0)
        err.seek(0)
        code = -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)
        return subprocess.CompletedProcess(command, code, out.read(), err.read())


def damage(content, kind, rng):
    """A file with a bit flipped, cut, or with a block of zeros."""
    at = int(rng.integers(len(content)))
    if kind == "cut":
        return content[:at]
    damaged = bytearray(content)
    if kind == "flip":
        damaged[at] ^= 1 << int(rng.integers(8))
    else:
        damaged[at : at + 64] = bytes(len(damaged[at : at + 64]))
    return bytes(damaged)


def write_csv(path):
    np.savetxt(path, np.column_stack([TIMES, X]), "%.6f", ",", header="time [s],x [m],y [m]", comments="")


def write_txt(path):
    np.savetxt(path, np.column_stack([TIMES, X]), "%.6f", "\t", header="t\tx\ty", comments="% ")


FILES = {
    "a.csv": write_csv,
    "a.txt": write_txt,
    "a.npz": lambda path: Demonstrations([X, X], dt=0.1).save_npz(path),
    "a.mat": lambda path: scipy.io.savemat(path, {"demos": as_matlab([X.T, X.T]), "dt": 0.1}),
}
PLACES = min(200, CASES) or 20


@pytest.mark.parametrize("kind", ["flip", "cut", "zeros"])
@pytest.mark.parametrize("name", FILES)
@pytest.mark.slow
def test_damaged_files(tmp_path, monkeypatch, name, kind):
    """Bits flipped and bytes cut at places all over the file; a crash of the other process is a refusal here."""
    monkeypatch.setattr("torchds.recordings.matlab.subprocess.run", in_a_fork)
    path, rng = tmp_path / name, np.random.default_rng(None if CASES else [len(name), len(kind)])
    FILES[name](path)
    content = path.read_bytes()
    assert load(path)[0].x.shape == X.shape
    for _ in range(PLACES):
        path.write_bytes(damage(content, kind, rng))
        TRIED["test_recordings"] += 1
        is_read_or_refused(path)


def test_a_reader_that_crashes_is_a_refusal(tmp_path, monkeypatch):
    monkeypatch.setattr("torchds.recordings.matlab.subprocess.run", in_a_fork)
    monkeypatch.setattr(matlab_process, "main", lambda path: os.kill(os.getpid(), signal.SIGSEGV))
    FILES["a.mat"](tmp_path / "a.mat")
    with pytest.raises(FileError, match="the reader crashed"):
        load(tmp_path / "a.mat")
