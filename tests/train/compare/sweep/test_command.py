"""Sweeps by several real workers that are killed at random moments, and what they say about themselves."""

import contextlib
import json
import os
import random
import signal
import sys
import time
from types import SimpleNamespace

import pytest
import torch

from tests.forked import forked
from tests.motions import Short
from torchds import files
from torchds.errors import InvalidArgumentError, MissingPackageError
from train.compare import report as report_module
from train.compare.sweep import command, worker
from train.compare.sweep.command import Sweep
from train.folder import Interrupted
from train.learning import kept
from train.learning.learner import Learner

JOBS = 'task = "via_point"\noptimizer = ["pibb", "nes"]\nseeds = {}\nupdates = 5\nrollouts = 4'
QUICK = {"beat": 0.05, "patience": 0.6, "attempts": 1000}


@pytest.fixture
def sweep(tmp_path, monkeypatch):
    """A sweep of 2 n jobs that take a few hundredths of a second, with a checkpoint after every update."""
    task = Short()
    task.policy()
    monkeypatch.setattr(worker, "made", lambda options: task)
    monkeypatch.setattr(kept, "SAVE_EVERY", -1.0)
    monkeypatch.setattr(os, "fsync", lambda handle: None)  # processes are killed here, not machines

    def make(n, name="mine", **options):
        spec = tmp_path / f"{name}.toml"
        spec.write_text(JOBS.format(n))
        return Sweep(spec, **{"logdir": tmp_path / "logs", **QUICK, **options})

    return make


def records(folder):
    """What the jobs found out, by name."""
    found = {}
    for path in sorted(folder.glob("runs/*/results.json")):
        content = files.read_sealed(path)
        found[path.parent.name] = [content[key] for key in ("options", "rollouts", "cost", "terms", "failed")]
    return found


def killed(sweep, workers, kills, rng):
    """Several workers, one of which is killed now and then and replaced; returns how often."""
    done, running = 0, []
    while True:
        while len(running) < workers:
            if (pid := os.fork()) == 0:
                torch.set_num_threads(1)
                code = 1
                try:
                    with contextlib.redirect_stdout(None):
                        sweep.main()
                    code = 0
                finally:
                    os._exit(code)
            running.append(pid)
        time.sleep(rng.uniform(0.02, 0.15))
        if done < kills:
            os.kill(running[rng.randrange(workers)], signal.SIGKILL)
            done += 1
        for pid in list(running):
            ended, status = os.waitpid(pid, os.WNOHANG if done < kills else 0)
            if ended:
                running.remove(pid)
                if (code := os.waitstatus_to_exitcode(status)) == 0:
                    return done, [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in running]
                assert code == -signal.SIGKILL


@pytest.mark.slow
def test_three_workers_that_are_killed_do_what_one_does(sweep, monkeypatch, capfd):
    monkeypatch.setattr(report_module, "curves", lambda rows: command.report.Figure())
    one = sweep(30, "one")
    one.main()
    expected = records(one.folder)
    assert len(expected) == 60
    three = sweep(30, "three")
    kills, others = killed(three, 3, 20, random.Random(0))
    assert kills == 20 and set(others) <= {0, -signal.SIGKILL}
    assert records(three.folder) == expected
    claims = [path.name for path in (three.folder / "claims").iterdir()]
    assert len(claims) > 61  # some were taken up again
    for path in three.folder.glob("runs/*/results.json"):  # and none that was finished
        last = max(int(name.rpartition(".")[2]) for name in claims if name.startswith(path.parent.name))
        made = (three.folder / "claims" / f"{path.parent.name}.{last}").read_text()
        assert time.strptime(made.split("since ")[1].strip(), "%Y-%m-%d %H:%M:%S") <= time.localtime(
            path.stat().st_mtime
        )
        assert not path.with_name("checkpoint.pt").exists() and path.with_name("policy.pt").is_file()
    ours, theirs = ((it.folder / "report" / "curves.csv").read_bytes() for it in (one, three))
    assert ours == theirs


@pytest.mark.slow
def test_a_sweep_leaves_the_report_of_compare(sweep, capsys):
    mine = sweep(3)
    mine.main()
    page = (mine.folder / "report" / "report.md").read_text()
    assert "## via_point-N" in page and "| pibb | no |" in page and "| nes | no |" in page and "Tuning" not in page
    for name in ("curves.png", "table.csv", "000/events.out.tfevents.run"):
        assert (mine.folder / "report" / name).stat().st_size > 0
    assert json.loads((mine.folder / "report" / "made_of.json").read_text())["jobs"]
    table = (mine.folder / "report" / "table.csv").read_text().splitlines()
    assert len(table) == 3 and ",3," in table[1]  # two rows of three runs
    said = capsys.readouterr().out
    assert said.startswith("6 jobs in ") and "6 jobs done, 0 failed" in said
    before = (mine.folder / "report" / "report.md").stat().st_mtime_ns
    mine.main()
    assert (mine.folder / "report" / "report.md").stat().st_mtime_ns == before


@pytest.mark.slow
def test_what_fails_is_said_and_can_be_tried_again(sweep, monkeypatch, capsys, tmp_path):
    mine = sweep(1)
    update = Learner.update

    def broken(learner):
        if learner.options.optimizer == "nes":
            raise ZeroDivisionError("no luck")
        return update(learner)

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", broken)
        mine.main()
    assert "1 jobs done, 1 failed" in capsys.readouterr().out
    assert "- nes: ZeroDivisionError: no luck" in (mine.folder / "report" / "report.md").read_text()
    (failure,) = (mine.folder / "failed").iterdir()
    assert "in broken" in files.read_sealed(failure)["traceback"]
    Sweep(mine.spec, "status", logdir=mine.logdir).main()
    said = capsys.readouterr().out
    assert "1 done, 1 failed" in said and "failed: ZeroDivisionError: no luck" in said
    Sweep(mine.spec, "retry", logdir=mine.logdir).main()
    assert "1 jobs are open again" in capsys.readouterr().out
    Sweep(mine.spec, "status", logdir=mine.logdir).main()
    assert "1 done, 1 open" in capsys.readouterr().out
    mine.main()
    assert "2 jobs done, 0 failed" in capsys.readouterr().out


@pytest.mark.slow
def test_a_job_over_which_workers_die_fails_in_the_end(sweep, monkeypatch, capfd):
    mine = sweep(1, attempts=2, patience=0.1)
    monkeypatch.setattr(mine.__class__, "report", lambda self, runs: command.Work("report", lambda: True, print))
    update = Learner.update

    def deadly(learner):
        if learner.options.optimizer == "nes":
            os.kill(os.getpid(), signal.SIGKILL)
        return update(learner)

    monkeypatch.setattr(Learner, "update", deadly)
    ended = [forked(1, lambda rank: mine.main())[0][0] for _ in range(3)]
    assert ended == [-signal.SIGKILL, -signal.SIGKILL, 0]
    Sweep(mine.spec, "status", logdir=mine.logdir).main()
    assert "2 workers died over it" in capfd.readouterr().out


@pytest.mark.slow
def test_an_interrupted_worker_gives_its_job_back(sweep, monkeypatch, capsys):
    mine = sweep(1, patience=600.0)

    def interrupted(learner):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", interrupted)
        with pytest.raises(Interrupted, match="the same command continues"):
            mine.main()
    Sweep(mine.spec, "status", logdir=mine.logdir).main()
    assert "2 open" in capsys.readouterr().out
    mine.main()
    assert "2 jobs done" in capsys.readouterr().out


@pytest.mark.slow
def test_a_claimed_job_is_shown_with_its_worker(sweep, capsys):
    mine = sweep(1)
    claims = command.Claims(mine.folder / "claims", 9.0, 90.0)
    job = command.spec.read(mine.spec)[0]
    with claims.take(job.name, command.Seen()):
        Sweep(mine.spec, "status", logdir=mine.logdir).main()
    said = capsys.readouterr().out
    assert f"process {os.getpid()} on " in said and "last sign of life 0 s ago" in said


def test_wrong_numbers_are_refused(sweep):
    for wrong in ({"beat": 2.0}, {"beat": 0.0}, {"attempts": 0}, {"submit": -1}, {"minutes": 0}):
        with pytest.raises(InvalidArgumentError, match="0 < --beat < --patience"):
            sweep(1, **wrong).main()


def test_submitting_needs_its_package(sweep, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(MissingPackageError, match=r"sweep --submit needs the package 'submitit'.*torchds\[cluster\]"):
        sweep(1, submit=2).main()


SAID = {}


class Executor:
    """What submitit has, in this process; .ci/run has real ones."""

    def __init__(self, folder, cluster):
        self.update_parameters(folder=folder, cluster=cluster)

    def update_parameters(self, **parameters):
        SAID.update(parameters)

    def submit(self, call, *arguments):
        return SimpleNamespace(job_id=f"{call.__name__}", result=lambda: call(*arguments))


@pytest.mark.slow
def test_submitted_workers_do_it_too(sweep, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "submitit", SimpleNamespace(AutoExecutor=Executor))
    mine = sweep(1, submit=2, cluster="local", partition="night", minutes=7)
    mine.main()
    assert len(records(mine.folder)) == 2
    assert "workers one_thread, one_thread; what they say is in " in capsys.readouterr().out
    said = dict(SAID)
    assert said.pop("folder") == mine.folder / "submitit" and said.pop("name") == "torchds-mine"
    assert said == {"cluster": "local", "timeout_min": 7, "cpus_per_task": 1, "slurm_partition": "night"}
