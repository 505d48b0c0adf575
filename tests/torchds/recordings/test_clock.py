"""Clocks in the forms that people have them: read right, or refused with the call that reads them right."""

import numpy as np
import pytest

from tests.motions import refuses
from tests.recorded import COUNT, DT, TIMES, N, X, is_motion, table, whole
from torchds import load
from torchds.errors import DemonstrationWarning, FileError, UnknownNameError

EPOCH = 1700000000
CLOCKS = {
    "t": ("t,x,y", TIMES),
    "time": ("time,x,y", TIMES),
    "percent": ("%time,x,y", TIMES),
    "comment": ("# time,x,y", TIMES),
    "timestamp": ("timestamp,x,y", TIMES),
    "stamp": ("stamp,x,y", TIMES),
    "brackets": ("time [s],x,y", TIMES),
    "milliseconds in brackets": ("time (ms),x,y", 1e3 * TIMES),
    "time_ms": ("time_ms,x,y", whole(10 * COUNT)),
    "t_us": ("t_us,x,y", whole(10_000 * COUNT)),
    "whole nanoseconds": ("time,x,y", whole(10_000_000 * COUNT)),
    "whole microseconds": ("time,x,y", whole(10_000 * COUNT)),
    "epoch in s": ("time,x,y", EPOCH + TIMES),
    "epoch in ms": ("time,x,y", [str(1000 * EPOCH + 10 * k) for k in range(N)]),
    "epoch in us": ("timestamp,x,y", [str(10**6 * EPOCH + 10**4 * k) for k in range(N)]),
    "epoch in ns": ("%time,x,y", [str(10**9 * EPOCH + 10**7 * k) for k in range(N)]),
}


@pytest.mark.parametrize("name", CLOCKS)
def test_time_is_recognised_by_its_names_and_units(file, name):
    header, stamps = CLOCKS[name]
    demos = load(file(table(header, stamps, *X.T)))
    assert is_motion(demos)
    assert demos.names == ("x", "y")


def test_seconds_and_nanoseconds_are_one_clock(file):
    rest = whole(10**7 * COUNT)
    assert is_motion(load(file(table("secs,nsecs,x,y", whole(0 * COUNT + EPOCH), rest, *X.T))))
    assert is_motion(load(file(table("header.stamp.sec,header.stamp.nanosec,x,y", whole(0 * COUNT), rest, *X.T))))


def test_whole_numbers_of_unknown_unit_are_asked_for(file):
    path = file(table("time,x,y", whole(10 * COUNT), *X.T))
    with refuses(FileError, "column 'time'", "in steps of 10", "time_unit="):
        load(path)
    assert is_motion(load(path, time_unit="ms"))
    assert is_motion(load(path, time_unit="s"), dt=10.0)
    with refuses(UnknownNameError, "time_unit 'hours'", "Known: min, ms, ns, s, us"):
        load(path, time_unit="hours")


def test_two_clocks_are_chosen_between(file):
    path = file(table("t,time,x,y", TIMES, 2 * TIMES, *X.T))
    with refuses(FileError, "t and time could be time", "time='t'"):
        load(path)
    with pytest.warns(DemonstrationWarning, match=r"left out are t \(time\)"):
        assert is_motion(load(path, time="time"), dt=2 * DT)


def test_a_message_of_ros(file):
    stamps = [str(10**9 * EPOCH + 10**7 * k) for k in range(N)]
    header = "%time,field.header.seq,field.header.stamp,field.pose.position.x,field.pose.position.y"
    path = file(table(header, stamps, whole(COUNT), stamps, *X.T))
    with pytest.warns(DemonstrationWarning, match=r"left out are .*seq \(counter\), .*header.stamp \(time\)"):
        demos = load(path)
    assert is_motion(demos)
    assert demos.names == ("field.pose.position.x", "field.pose.position.y")


@pytest.mark.parametrize("start", [0.0, float(EPOCH)])
def test_jitter_is_refused_with_all_digits_and_resampled_on_request(file, start):
    times = start + TIMES
    times[7] += 0.0003
    path = file(table("time,x,y", times, *X.T))
    with refuses(
        FileError, "row 6 to row 7", f"from {start + 0.06!r} to {round(start + 0.0703, 6)!r}", "resample=True"
    ):
        load(path)
    with pytest.warns(DemonstrationWarning, match="20 samples at .* resampled to 20 at 0.01 s by cubic splines"):
        demos = load(path, resample=True)
    assert is_motion(demos, atol=5e-3)  # the sample that came late, moved to its time
    assert load(path, resample=0.005).dt == pytest.approx((0.005,), rel=1e-6)


def test_a_stamp_that_stands_twice_is_dropped_on_request(file):
    times, x = np.append(TIMES, TIMES[-1]), np.append(X, X[-1:], 0)
    path = file(table("time,x,y", times, *x.T))
    with refuses(FileError, "row 19 to row 20", "from 0.19 to 0.19 s", "stands still", "duplicates='drop'"):
        load(path)
    with pytest.warns(DemonstrationWarning, match="1 sample"):
        assert is_motion(load(path, duplicates="drop"))


def test_samples_out_of_order_are_dropped_on_request(file):
    order = [*range(8), 9, 8, *range(10, N)]
    path = file(table("time,x,y", TIMES[order], *X[order].T))
    with refuses(FileError, "row 8 to row 9", "the time goes back", "duplicates='drop'"):
        load(path)
    assert load(path, duplicates="drop", resample=0.01)[0].x.shape == (N, 2)


def test_missing_stamps_and_samples_are_bridged_on_request(file):
    lines = table("time,x,y", TIMES, *X.T).splitlines()
    lines[5] = ",".join(["", *lines[5].split(",")[1:]])
    lines[9] = ",".join([*lines[9].split(",")[:2], "nan"])
    path = file("\n".join(lines))
    with refuses(FileError, "line 10, column 'y': 'nan' is not a finite number", "resample=True"):
        load(path)
    with pytest.warns(DemonstrationWarning, match=r"2 row\(s\) in which something is missing"):
        demos = load(path, resample=0.01)
    assert is_motion(demos, atol=1e-5)


def test_no_time_step_is_asked_for_where_a_clock_stands(file):
    times = TIMES**1.5
    for name in ("t", "time_s", "stamp"):
        with pytest.raises(FileError) as refused:
            load(file(table(f"{name},x,y", times, *X.T)))
        assert "dt=" not in str(refused.value)
