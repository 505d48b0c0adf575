"""python -m train benchmark: what it times, and what it compares with, at its smallest."""

import json

import pytest
import torch

import tasks
from torchds import rollout
from torchds.errors import FileError, InvalidArgumentError
from train.benchmark import command
from train.benchmark.command import Benchmark, compared, in_words, read
from train.benchmark.floor import compile_floor, run_floor
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
    assert compared(found, found).startswith("nothing is slower than on 20")


@pytest.mark.slow
def test_without_a_compiler_there_is_no_floor(quick, monkeypatch, capsys):
    monkeypatch.setattr("shutil.which", lambda name: None)
    Benchmark(repeats=1).main()
    shown = capsys.readouterr().out
    assert "no C++ compiler here" in shown and "2 roll-outs" in shown


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
