"""Runs by real processes, forked: what they leave is what one process leaves."""

import os
import signal
import threading
import time

import pytest
import torch.distributed as dist

from tests.faults.ranks import differing, outcome
from tests.forked import forked
from tests.motions import Short
from torchds.errors import InvalidArgumentError, ProcessLostError
from train.learning import run as run_module
from train.learning.processes import Processes, agreed, joined
from train.options import RunOptions, options_for

CASES = {
    "surrogate along the motion": {"optimizer": "surrogate", "exploration": "trajectory", "rollouts": 5},
    "PI2, noisy costs": {"optimizer": "pi2", "rollouts": 5, "cost_noise": 0.1},
    "NES, noisy costs": {"optimizer": "nes", "rollouts": 5, "cost_noise": 0.1},
    "COBYQA, one trial at a time": {"optimizer": "cobyqa", "runs": 1, "rollouts": 2},
}


def options(folder, **values):
    return options_for("via_point", **{"runs": 2, "updates": 3, "folder": folder, **values})


@pytest.fixture
def short(monkeypatch):
    task = Short()
    monkeypatch.setattr(RunOptions, "make_task", lambda options: task)
    monkeypatch.setattr(run_module.figures, "of_run", lambda learner: {})


@pytest.mark.slow
def test_two_processes_leave_what_one_leaves(short, tmp_path):
    def both(rank):
        dist.init_process_group("gloo")
        for name, values in CASES.items():
            run_module.run(options(tmp_path / "two" / name, **values))

    for name, values in CASES.items():
        run_module.run(options(tmp_path / "one" / name, **values))
    for code, said in forked(2, both):
        assert code == 0, said
    for name in CASES:
        assert not differing(outcome(tmp_path / "one" / name), outcome(tmp_path / "two" / name)), name


@pytest.mark.slow
def test_a_process_that_dies_stops_the_others_and_one_goes_on_to_the_same_end(short, monkeypatch, tmp_path):
    monkeypatch.setattr(run_module, "SAVE_EVERY", 0.0)
    update = run_module.Learner.update

    def dies(learner):
        if learner.done == 2 and os.environ.get("RANK") == "1":
            os.kill(os.getpid(), signal.SIGKILL)
        return update(learner)

    monkeypatch.setattr(run_module.Learner, "update", dies)
    (first, said), (second, _) = forked(2, lambda rank: run_module.run(options(tmp_path / "two", patience=20.0)))
    assert second == -signal.SIGKILL and first == 1
    assert "ProcessLostError: process 0 of 2 has lost another one" in said
    assert not (tmp_path / "two" / "results.json").exists()
    for name in ("two", "one"):
        run_module.run(options(tmp_path / name))
    assert not differing(outcome(tmp_path / "one"), outcome(tmp_path / "two"))


@pytest.mark.slow
def test_what_the_first_process_refuses_ends_the_others(short, tmp_path):
    (first, said), (second, quiet) = forked(2, lambda rank: run_module.run(options(tmp_path, runs=0)))
    assert first == 1 and "--runs has to be at least 1, got 0" in said
    assert second == 0 and not quiet


def test_without_torchrun_there_is_one_process(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with joined(1.0) as processes:
        assert type(processes) is Processes and (processes.rank, processes.size) == (0, 1)
        processes.tell("nobody")


def test_a_restart_has_to_find_the_run(short, monkeypatch, tmp_path):
    monkeypatch.setenv("TORCHELASTIC_MAX_RESTARTS", "3")
    with pytest.raises(InvalidArgumentError, match="--max-restarts needs --folder DIR or --resume DIR"):
        run_module.run(options_for("via_point", logdir=tmp_path))


@pytest.mark.slow
def test_a_command_with_a_folder_can_be_given_again(short, tmp_path, capsys):
    asked = options(tmp_path / "mine")
    assert run_module.run(asked) == tmp_path / "mine"
    before = outcome(tmp_path / "mine")
    run_module.run(asked)
    assert "all 3 updates are made" in capsys.readouterr().out
    assert not differing(before, outcome(tmp_path / "mine"))
    with pytest.raises(InvalidArgumentError, match=r"--folder .* cannot take --rollouts 3"):
        run_module.run(options(tmp_path / "mine", rollouts=3))


def test_addresses_of_dead_processes_are_not_believed():
    store, names = dist.HashStore(), {}
    for name in ("hello 1", "found", "confirmed 1", "agreed"):  # what those before have left
        store.set(f"torchds {name}", "dead")
    first = threading.Thread(target=lambda: names.update({0: agreed(store, 0, 2, 20.0)}))
    first.start()
    time.sleep(0.2)
    assert not names  # the second is not there
    names[1] = agreed(store, 1, 2, 20.0)
    first.join()
    assert names[0] == names[1] and "dead" not in names[0]
    with pytest.raises(ProcessLostError, match="process 1 of 2 has not met all others"):
        agreed(store, 1, 2, 0.1)
