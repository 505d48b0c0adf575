import numpy as np
import pytest
import torch

from tests.motions import equal, refuses, sine, two
from torchds.demonstrations import Demonstrations
from torchds.errors import FileError, InvalidArgumentError
from torchds.recordings import load, load_npz


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
        ({"x0": np.zeros((5, 2)), "t0": np.arange(4.0)}, ["one for each of the 5 positions, got 4"]),
        (
            {"x0": np.zeros((5, 2)), "t0": [0, 1, 2, 4, 5.0]},
            ["have to be equal", "row 2 to row 3", "from 2.0 to 4.0 s", "resample=True"],
        ),
        ({"x0": np.zeros((5, 2)), "t0": [4, 3, 2, 1, 0.0]}, ["have to be equal", "row 0 to row 1"]),
        ({"x0": np.zeros((5, 2)), "t0": np.arange(5.0), "dt0": 0.1}, ["dt says 0.1 s but its time stamps 1 s"]),
        ({"x0": np.zeros((1, 2)), "t0": [0]}, ["demonstration 0 has to have at least two samples, got 1"]),
        ({"x0": np.array([[None, 1]]), "dt": 1}, ["is no readable .npz archive"]),
    ],
)
def test_npz_refuses(tmp_path, arrays, words):
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with refuses(FileError, str(path), *words):
        load_npz(path)


def test_a_damaged_npz_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    two().save_npz(path)
    content = bytearray(path.read_bytes())
    content[200:300] = bytes(100)
    path.write_bytes(content)
    with refuses(FileError, "a.npz is damaged", "checksum"):
        load(path)


def test_several_names_are_demonstrations_or_the_columns_of_one(tmp_path):
    X, path = np.random.default_rng(0).normal(size=(20, 2)), tmp_path / "a.npz"
    np.savez(path, first=X, second=2 * X, px=X[:, 0], py=X[:, 1], vx=-X[:, :1], vy=-X[:, 1:])
    assert [d.x.tolist() for d in load(path, positions=("first", "second"), dt=0.1)] == [X.tolist(), (2 * X).tolist()]
    (demo,) = load(path, positions=("px", "py"), velocities=("vx", "vy"), dt=0.1)
    assert demo.x.tolist() == X.tolist() and demo.v.tolist() == (-X).tolist()


def test_what_is_said_to_be_none_or_ignored_is_left_out(tmp_path):
    t, X = 0.1 * np.arange(20.0)[:, None], np.random.default_rng(0).normal(size=(20, 2))
    np.savez(tmp_path / "a.npz", demo0_x=X, demo0_v=-X, demo0_stiffness=X**2)
    (demo,) = load(tmp_path / "a.npz", velocities=(), stiffness=(), dt=0.1)
    assert demo.stiffness is None and not np.allclose(demo.v, -X)
    np.savez(tmp_path / "b.npz", demo0_x=np.concatenate([t, X], 1))
    assert load(tmp_path / "b.npz", ignore=0, dt=0.1)[0].x.tolist() == X.tolist()
    with pytest.raises(InvalidArgumentError, match="split has to be True or False where demonstrations are arrays"):
        load(tmp_path / "b.npz", split="trial", dt=0.1)
