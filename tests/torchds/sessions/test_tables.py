"""References and recordings as tables of any columns; those of digging are tested in tests/train/hardware."""

import math

import numpy as np
import pytest
import torch

from torchds.errors import FileError
from torchds.sessions import Layout, tables

LAYOUT = Layout(
    ("x [m]",), stiffness=("s [N/m]", "r [N m/rad]"), measured=("f [N]", "g [N]"), optional=("g [N]",), start=(0.1,)
)
T, DT = 20, 0.01


def write(folder, header, rows):
    path = folder / "recording-1.csv"
    np.savetxt(path, rows, "%.17g", ",", header=header, comments="")
    return path


def test_a_reference_has_all_digits_and_rests_at_its_end(tmp_path, randn):
    x, v, s = randn(T + 1, 1), randn(T, 1), randn(T, 2)
    header, *lines = tables.reference_text(LAYOUT, x, v, s, DT).splitlines()
    table = torch.tensor([[float(cell) for cell in line.split(",")] for line in lines], dtype=torch.float64)
    assert header == "time [s],x [m],v_x [m/s],s [N/m],r [N m/rad]"
    assert torch.equal(table[:, 1:2], x) and torch.equal(table[:-1, 2:3], v) and table[-1, 2] == 0
    assert torch.equal(table[:-1, 3:], s) and torch.equal(table[-1, 3:], s[-1])


def test_a_recording_of_any_rate_comes_to_the_control_steps(tmp_path):
    t = np.linspace(0, T * DT, 37)
    path = write(tmp_path, "f [N],time [s],other [K],x [m]", np.stack([3 * t, t, 0 * t, t**3], -1))
    found = tables.read_recording(LAYOUT, path, torch.zeros(1), T, DT)
    times = tables.control_times(T, DT)
    np.testing.assert_allclose(found.x[:, 0], times**3, atol=1e-13)
    np.testing.assert_allclose(found.measured, np.stack([3 * times, 0 * times], -1)[1:], atol=1e-13)


def test_columns_of_words_or_without_values_are_ignored_but_not_among_those_that_are_read(tmp_path):
    path = tmp_path / "recording-1.csv"
    rows = [f"{DT * k},impedance,{k},,{k}\n" for k in range(T + 1)]
    path.write_text("time [s],mode,x [m],note,f [N]\n" + "".join(rows))
    assert tables.read_recording(LAYOUT, path, torch.zeros(1), T, DT).x[-1].tolist() == [T]
    path.write_text(path.read_text().replace("impedance,7,", "impedance,seven,"))
    with pytest.raises(FileError, match=r"line 9, column 'x \[m\]': 'seven' is not a finite number"):
        tables.read_recording(LAYOUT, path, torch.zeros(1), T, DT)


def test_a_slow_reference_allows_recordings_that_are_as_slow(tmp_path):
    path = write(tmp_path, "time [s],x [m],f [N]", np.stack([np.arange(T + 1.0)] * 3, -1))
    assert tables.read_recording(LAYOUT, path, torch.zeros(1), T, 1.0).x.shape == (T + 1, 1)


@pytest.mark.parametrize(
    ("header", "change", "words"),
    [
        ("time [s],x [mm],f [N]", lambda t: t, r"no column 'x \[m\]'.*\(g \[N\] may be left out\)"),
        ("time [s],x [m],f [N]", lambda t: t + 0.2, r"starts at x \[m\] = 0.2, its reference at 0"),
        ("time [s],x [m],f [N]", lambda t: t[:-5], "lasts from 0 to 0.15 s, the motion from 0 to 0.2 s"),
        ("time [s],x [m],f [N]", lambda t: t * np.nan, "not a finite"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, header, change, words):
    t = np.arange(T + 1) * DT
    x = change(t)
    path = write(tmp_path, header, np.stack([t[: len(x)], x, x], -1))
    with pytest.raises(FileError, match=words):
        tables.read_recording(LAYOUT, path, torch.zeros(1), T, DT)


def test_costs_say_what_failed(tmp_path):
    (tmp_path / tables.COSTS).write_text("rollout,cost\n1,2.5\n3,failed\n")
    assert tables.read_costs(tmp_path / tables.COSTS, 3) == {1: 2.5, 3: math.inf}
    assert tables.returned(tmp_path, 3) == ["there", "missing", "failed"]
