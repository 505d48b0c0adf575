"""Processes beside the page: they answer, and none is left behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from tests import drawn
from torchds.errors import InvalidArgumentError
from train.view.studio.imitating import Imitation, imitate
from train.view.studio.worker import Failed, Worker, said

pytestmark = pytest.mark.slow
PATIENCE = 120  # s


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def running(pid):
    """Whether there is such a process that is more than a record of its end."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_it_answers_and_ends_with_its_pipe_and_a_killed_one_is_noticed():
    worker = Worker(imitate)
    worker.tell((7, drawn.problem()))
    found = []
    until(lambda: found.extend(worker.answers()) or found)
    ((number, made),) = found
    assert number == 7 and isinstance(made, Imitation) and made.policy.n_components == 4
    pid = worker.process.pid
    worker.end()
    assert not running(pid)

    worker = Worker(imitate)
    until(lambda: worker.process.pid)
    os.kill(worker.process.pid, signal.SIGKILL)
    until(lambda: worker.answers() is None)
    worker.tell((8, drawn.problem()))  # nobody hears it, and nothing happens
    worker.end()


def busy(pipe):
    """Works for 3 s before it listens."""
    pipe.send("begun")
    time.sleep(3)
    pipe.next()


def test_a_process_that_is_busy_is_left_without_waiting():
    worker = Worker(busy)
    until(lambda: worker.answers())
    began = time.monotonic()
    worker.leave()
    assert time.monotonic() - began < 1
    until(lambda: not running(worker.process.pid))


def test_a_process_that_never_began_is_one_that_has_ended(monkeypatch):
    def start(self):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(multiprocessing.context.ForkServerProcess, "start", start)
    worker = Worker(imitate)
    until(lambda: worker.answers() is None)
    worker.tell((1, drawn.problem()))
    worker.end()
    worker.end()


ORPHANS = """
import os, time
from train.view.studio.imitating import imitate
from train.view.studio.worker import Worker
if __name__ == "__main__":
    workers = [Worker(imitate) for _ in range(2)]
    while not all(worker.process.pid for worker in workers):
        time.sleep(0.02)
    print(*(worker.process.pid for worker in workers), flush=True)
    time.sleep(600)
"""


def test_a_killed_page_leaves_no_process_behind(tmp_path):
    (tmp_path / "page.py").write_text(ORPHANS)
    root = os.getcwd()
    page = subprocess.Popen(
        [sys.executable, str(tmp_path / "page.py")], stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": root}
    )
    workers = [int(pid) for pid in page.stdout.readline().split()]
    assert len(workers) == 2 and all(map(running, workers))
    page.kill()
    page.wait()
    page.stdout.close()
    until(lambda: not any(map(running, workers)))


def test_what_goes_wrong_is_a_sentence():
    def raises(error):
        raise error

    assert said(lambda: 3) == 3
    assert said(lambda: raises(InvalidArgumentError("a\n  b"))) == Failed("a b")
    assert "ZeroDivisionError" in said(lambda: raises(ZeroDivisionError("by zero"))).message
    with pytest.raises(EOFError):
        said(lambda: raises(EOFError()))
