"""python -m train latency: a table with a row for each form."""

import pytest

from train.hardware import latency
from train.hardware.latency import Latency, forms, policy


@pytest.mark.slow
def test_a_row_for_each_form_with_median_and_tail(capsys, monkeypatch):
    monkeypatch.setattr(latency.importlib.util, "find_spec", lambda name: None)  # nothing is compiled
    monkeypatch.setattr(latency.shutil, "which", lambda name: None)
    Latency(ticks=20).main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("| form | D = 2, K = 4: median [µs] | D = 2, K = 4: 99 % [µs] | D = 6, K = 10: median")
    assert [line.split(" | ")[0] for line in lines[3:]] == [
        "| `Controller`, numpy",
        "| `Controller`, numpy, within bounds",
        "| `Controller`, numpy, feedback",
        "| `policy(x)`, torch without gradients",
    ]
    for line in lines[3:]:
        numbers = [float(cell) for cell in line.strip("| ").split(" | ")[1:]]
        assert len(numbers) == 4 and 0 < numbers[0] <= numbers[1] < 1e6


@pytest.mark.slow
def test_all_forms_give_the_same_velocity(monkeypatch):
    which = latency.shutil.which
    monkeypatch.setattr(latency.shutil, "which", lambda name: which(name) if name == "gcc" else None)
    monkeypatch.setattr(latency.importlib.util, "find_spec", lambda name: None)
    calls = dict(forms(policy(2, 4)))
    expected = calls["`policy(x)`, torch without gradients"]().tolist()
    for name in ("`Controller`, numpy", "`Controller`, numpy, feedback"):
        assert calls[name]().v.tolist() == pytest.approx(expected, rel=1e-12)
    for name, call in calls.items():
        if name.startswith("`export("):
            (v,) = call()
            assert v.ravel().tolist() == pytest.approx(expected, rel=1e-12), name
