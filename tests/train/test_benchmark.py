"""python -m train benchmark: what it times, at its smallest."""

import re

from train.benchmark import Benchmark


def test_medians_of_both_batches_and_of_the_noise_along_the_motion_are_printed(capsys):
    Benchmark(repeats=1, updates=1, digging=0.0).main()
    shown = capsys.readouterr().out
    seconds = re.findall(r"(\d+) runs x 1 updates: median ([\d.]+) s", shown)
    assert [runs for runs, _ in seconds] == ["20", "1"]
    refresh = re.findall(r"(\d+) runs: TrajectorySpace refreshes in ([\d.]+) ms", shown)
    assert [runs for runs, _ in refresh] == ["20", "1"]
    assert all(float(value) > 0 for _, value in refresh)
    assert "python 3" in shown and "digging" not in shown
