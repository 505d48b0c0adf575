import numpy as np
import pytest
import scipy.io

from tests.motions import equal, refuses, sine, two
from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.recordings import load, load_mat


def cell(items):
    array = np.empty((1, len(items)), dtype=object)
    array[0, :] = items
    return array


@pytest.mark.parametrize("rows", [True, False])
@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_mat_with_forward_differences_drops_the_last_position(tmp_path):
    x, _, dt = sine()
    scipy.io.savemat(tmp_path / "a.mat", {"demos": cell([{"pos": x.T, "vel": np.diff(x.T) / dt, "dt": dt}])})
    assert equal(load_mat(tmp_path / "a.mat"), Demonstrations([x], dt=dt).forward_differences())


@pytest.mark.slow
def test_mat_time_axis(tmp_path):
    path = tmp_path / "a.mat"
    square = np.arange(9.0).reshape(3, 3)
    scipy.io.savemat(path, {"demos": cell([np.zeros((3, 9)), square]), "dt": 0.1})
    with refuses(FileError, "demonstration 1 are 3 x 3", "time_axis=0", "time_axis=1"):
        load_mat(path)
    assert load_mat(path, time_axis=1)[1].x.tolist() == square.T.tolist()
    with refuses(InvalidArgumentError, "time_axis has to be 0", "got 2"):
        load_mat(path, time_axis=2)


@pytest.mark.slow
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
@pytest.mark.slow
def test_mat_refuses(tmp_path, contents, words):
    path = tmp_path / "bad.mat"
    scipy.io.savemat(path, contents)
    with refuses(FileError, str(path), *words):
        load_mat(path)


@pytest.mark.slow
def test_mat_of_version_73_says_how_to_save_it(tmp_path):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    (tmp_path / "a.mat").write_bytes(header + bytes(400))
    with refuses(FileError, "MATLAB 7.3", "-v7"):
        load_mat(tmp_path / "a.mat")


def test_mat_several_names_are_demonstrations_or_the_columns_of_one(tmp_path):
    X, path = np.random.default_rng(0).normal(size=(20, 2)), tmp_path / "a.mat"
    scipy.io.savemat(path, {"first": X, "second": 2 * X, "px": X[:, :1], "py": X[:, 1:]})
    assert [d.x.tolist() for d in load(path, positions=("first", "second"), dt=0.1)] == [X.tolist(), (2 * X).tolist()]
    (demo,) = load(path, positions=("px", "py"), dt=0.1)
    assert demo.x.tolist() == X.tolist()


def test_mat_columns_by_number_in_structs_and_matrices(tmp_path):
    t, X, path = 0.1 * np.arange(20.0)[:, None], np.random.default_rng(0).normal(size=(20, 2)), tmp_path / "a.mat"
    scipy.io.savemat(path, {"s": {"x": np.concatenate([t, X], 1)}})
    assert load(path, positions=(1, 2), time=0)[0].x.tolist() == X.tolist()
    scipy.io.savemat(path, {"m": np.concatenate([t, X], 1)})
    assert load(path, ignore=0, dt=0.1)[0].x.tolist() == X.tolist()
