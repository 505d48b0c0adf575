"""python -m train benchmark: what it times, and what it compares with, at its smallest."""

import json
import sys

import pytest
import torch

import tasks
from torchds import GMRPolicy, rollout
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from train.benchmark import command
from train.benchmark.command import Benchmark, compared, in_words, measure, read
from train.benchmark.floor import Floor, compile_floor, run_floor
from train.benchmark.rows import Row


@pytest.mark.slow
def test_the_floor_is_the_same_algorithm(tmp_path):
    """Its motion is ours to round-off, it begins with our cost, and it learns."""
    program = compile_floor(tmp_path)
    if program is None:
        pytest.skip("needs a C++ compiler")
    task = tasks.make("via_point")
    policy = task.policy().requires_grad_(False)
    floor = run_floor(program, task, policy, 10, task.motion().n_steps, 20, repeats=2)
    path = task.rollout(policy)
    assert floor.ends == pytest.approx(float(path.x[-1].sum()), rel=1e-10)
    assert floor.before == pytest.approx(float(task.cost(path)), rel=1e-9)
    assert floor.after < 0.7 * floor.before
    assert len(floor.passes) == len(floor.runs) == 2 and floor.passes == sorted(floor.passes)


@pytest.fixture
def quick(monkeypatch):
    """Two rows, and a floor that takes a microsecond."""
    policy = tasks.make("via_point").policy().requires_grad_(False)
    x0 = torch.zeros(2, dtype=torch.float64)
    few = Row("2 roll-outs", lambda: rollout(policy, x0, 2, 0.1), ("passes", 2))
    monkeypatch.setattr(command, "rows", lambda *_: [few, Row("nothing", lambda: None)])
    monkeypatch.setattr(Benchmark, "floor", lambda self, program, row, policy: [1e-6] * 3)


@pytest.mark.slow
def test_the_table_has_the_ratio_first_and_is_written_and_compared(quick, tmp_path, capsys):
    file = tmp_path / "speed.json"
    Benchmark(repeats=2, json=file).main()
    shown = capsys.readouterr().out
    found = json.loads(file.read_text())
    assert [row["name"] for row in found["rows"]] == ["2 roll-outs", "nothing"]
    if found["rows"][0]["ratio"] is not None:  # with a compiler
        assert found["rows"][0]["ratio"] == pytest.approx(found["rows"][0]["median"] / 1e-6)
    assert "| | over the floor | median |" in shown.replace("|  |", "| |") and "torch 2" in shown
    found["rows"][0]["quartiles"] = [1e-12, 1e-12]
    found["rows"][0]["median"] = 1e-12
    file.write_text(json.dumps(found))
    Benchmark(repeats=2, only="roll-outs", against=file).main()
    assert "slower: 2 roll-outs: " in capsys.readouterr().out
    with pytest.raises(UnknownNameError, match=r"unknown row 'rollouts'\. Did you mean '2 roll-outs'"):
        Benchmark(only="rollouts", against=file).main()
    file.write_text(json.dumps({**found, "device": "another"}))
    with pytest.raises(
        InvalidArgumentError, match="has the times of another, and here is cpu, one thread; give a file"
    ):
        Benchmark(against=file).main()


@pytest.mark.slow
@pytest.mark.parametrize("compiler", [None, sys.executable])
def test_without_a_compiler_that_works_there_is_no_floor(quick, compiler, monkeypatch, capsys):
    monkeypatch.setattr("shutil.which", lambda name: compiler)
    Benchmark(repeats=1).main()
    shown = capsys.readouterr().out
    assert "no C++ compiler here" in shown and "2 roll-outs" in shown
    assert (compiler is not None) == ("ended with exit code" in shown)


def test_only_what_both_have_is_compared():
    one, two, three = ({"name": f"run {n}", "median": 2.0, "quartiles": [1.9, 2.1]} for n in (1, 2, 3))
    before, now = {"date": "2020-02-02", "rows": [one, two]}, {"rows": [two, three]}
    none = "of 1 rows none is slower than on 2020-02-02 by more than the spread"
    assert compared(now, before).splitlines() == [
        none,
        "not compared: run 3: not in the file of 2020-02-02",
        "not compared: run 1: not timed now",
    ]
    assert compared(now, before, "2") == none
    slow = {**two, "median": 3.0, "quartiles": [2.2, 4.0]}
    assert compared({"rows": [slow]}, before, "2") == "slower: run 2: 3 s, was 2 s"


@pytest.mark.parametrize(("seconds", "repeats", "calls"), [((5.0, 0.001), 2, 202), ((0.001, 1.0), 2, 3)])
def test_what_compiles_in_its_first_call_is_timed_as_often_as_it_is_short(seconds, repeats, calls, monkeypatch):
    made, now = [], [0.0]

    def call():
        now[0] += seconds[bool(made)]
        made.append(1)

    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    assert measure(call, repeats) == pytest.approx([seconds[1]] * repeats)
    assert len(made) == calls


def test_no_repeats_are_refused():
    with pytest.raises(InvalidArgumentError, match="--repeats has to be at least 1, got 0"):
        Benchmark(repeats=0).main()


def test_the_floor_leaves_the_policy_where_it_is(monkeypatch):
    task = tasks.make("via_point").to(dtype=torch.float32)
    policy, moved = task.policy(), []
    monkeypatch.setattr(GMRPolicy, "to", lambda self, device: moved.append(self) or self)
    monkeypatch.setattr(command, "run_floor", lambda *_: Floor([1.0], [], 0.0, 0.0, 0.0))
    assert Benchmark().floor(None, Row("few", lambda: None, ("passes", 2), 3), policy) == [3.0]
    assert moved and policy not in moved


@pytest.mark.parametrize("content", [None, "no json", "{}", '{"date": "2026", "rows": [{}]}'])
def test_other_files_are_refused(tmp_path, content):
    file = tmp_path / "speed.json"
    if content is not None:
        file.write_text(content)
    with pytest.raises(FileError, match=r"speed\.json: not a file of python -m train benchmark --json"):
        read(file)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_refused():
    with pytest.raises(InvalidArgumentError, match="--device cuda needs a GPU"):
        Benchmark(device="cuda").main()


def test_times_have_a_unit_that_fits():
    assert [in_words(t) for t in (2.0, 0.0312, 4.56e-6)] == ["2 s", "31.2 ms", "4.56 µs"]
