import pytest
import torch

from tests.motions import equal, refuses
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.recordings import load, load_csv


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
    (tmp_path / "a.csv").write_text("t,x,y\n0.,1,2\n1.,3,4\n")
    (tmp_path / "b.csv").write_text("y,x,t\n2,1,0.\n4,3,1.\n")
    a, b = load_csv(tmp_path)
    assert torch.equal(a.x, b.x)


def test_csv_options(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("stamp,x,y,z,v_y,v_z\n0,1,2,3,4,5\n0.1,1,2,3,4,5\n")
    demos = load_csv(path, time="stamp", positions=["z", "y"])
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
        ("t;x\n0;1\n1;2,\n", ["line 3, column 'x': '2,'", "separated by semicolons"]),
        ("x,y\n0,1\n1,2\n", ["no time step", "dt="]),
        ("t,time,x\n0,1,1\n1,2,1\n", ["columns t and time", "time="]),
        ("t,v_x\n0,1\n1,2\n", ["none of the columns t, v_x is a position"]),
        ("t,x,y,v_x\n0,1,2,3\n1,1,2,3\n", ["the velocities are v_x but the positions x, y", "v_x, v_y"]),
        ("t,x,v_y\n0,1,2\n1,1,2\n", ["the velocities are v_y but the positions x"]),
        (
            "t,x\n0.,1\n1,2\n2,3\n4.5,4\n5.5,4\n",
            ["have to be equal", "row 2 to row 3", "1 s is usual", "resample=True"],
        ),
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
    (tmp_path / "a.csv").write_text("t,x\n0.5,1\n1.5,2\n")
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
        load_csv(tmp_path / "a.csv", time="stamp")
    with refuses(UnknownNameError, "column of a.csv 'X'", "Did you mean 'x'"):
        load_csv(tmp_path / "a.csv", positions=["X"])
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
    with refuses(FileError, "b.csv: not a text file"):
        load(tmp_path / "b.csv")


def lines(header, rows):
    return header + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)


@pytest.mark.parametrize("hole", [(), (20,), (49,)])
def test_whole_milliseconds_are_not_taken_for_seconds_where_a_row_is_missing(tmp_path, hole):
    rows = [(10 * i, i * i, i) if i not in hole else ("nan",) * 3 for i in range(50)]
    path = tmp_path / "a.csv"
    path.write_text(lines("t,x,y", rows))
    with refuses(FileError, "whole numbers whose unit cannot be told", "time_unit="):
        load(path, resample=True)
    assert load(path, resample=True, time_unit="ms").dt == pytest.approx((0.01,))


def test_a_unit_of_time_that_is_not_known_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(lines("time [h],x", [(1e-4 * i, i) for i in range(5)]))
    with refuses(FileError, "'time' is 'h'", "time_unit="):
        load(path)
    assert load(path, time_unit="s").dt == pytest.approx((1e-4,))


@pytest.mark.parametrize("how", [{}, {"positions": ("x", "y")}])
def test_files_with_columns_in_another_order_are_read_as_the_first(tmp_path, how):
    (tmp_path / "a.csv").write_text(
        lines("t,x,y,stiffness_x,stiffness_y", [(0.1 * i, i, 2 * i, 100, 900) for i in range(5)])
    )
    (tmp_path / "b.csv").write_text(
        lines("t,y,x,stiffness_y,stiffness_x", [(0.1 * i, 2 * i, i, 900, 100) for i in range(5)])
    )
    a, b = load(tmp_path, **how)
    assert torch.equal(a.x, b.x) and torch.equal(a.stiffness, b.stiffness)


@pytest.mark.parametrize("names", ["ab", "ba"])
def test_a_column_that_is_empty_in_one_file_is_not_left_out_silently(tmp_path, names):
    (tmp_path / "a.csv").write_text(lines("t,x,y,z", [(0.1 * i, i, 2 * i, 3 * i) for i in range(5)]))
    (tmp_path / "b.csv").write_text(lines("t,x,y,z", [(0.1 * i, i, 2 * i, "") for i in range(5)]))
    with refuses(FileError, "x is read from", "say which are meant, positions=("):
        load([tmp_path / f"{name}.csv" for name in names])


def test_a_column_by_number_counts_demonstrations_where_there_is_no_header(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("".join(f"{demo},{i},{2 * i}\n" for demo in (0, 1) for i in range(5)))
    assert len(load(path, positions=(1, 2), split=0, dt=0.1)) == 2
