"""Interrupts commands at their writes, in real processes: `python -m tests.faults.killer COMMAND CASES FAULT ...`.

A process is forked for each case from one that has given the command once, so that everything is imported and compiled. In the
child every call that changes the disk is counted: opening for writing, writing, flushing, moving, making, cutting and removing.
At the n-th one a fault happens: the process kills itself with SIGKILL (half of what was to be written is then there), or the
call fails as on a full, broken or read-only disk, and so do all that follow. Then the command is given again, without a fault,
and must end as if nothing had happened.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

FAULTS = {"kill": None, "full": errno.ENOSPC, "broken": errno.EIO, "read-only": errno.EROFS}
CHANGES = {"os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "os.link", "os.symlink"}


class Disk:
    """Counts the calls that change files below a folder, and lets the n-th fail.

    Args:
        folder: that is watched.
        at: the call that fails, from 1; 0 for none.
        fault: a name in `FAULTS`.
    """

    def __init__(self, folder, at, fault):
        self.folder, self.at, self.fault, self.calls = str(folder), at, FAULTS[fault], 0

    paused = False
    """While somebody else than the command writes, such as the robot."""

    def strike(self, half=lambda: None):
        """Count a call; fail if its turn has come."""
        self.calls += 1
        if self.at and self.calls >= self.at:
            if self.fault is None:
                half()
                os.kill(os.getpid(), signal.SIGKILL)
            raise OSError(self.fault, os.strerror(self.fault))

    def watched(self, path):
        return isinstance(path, (str, bytes, os.PathLike)) and os.fsdecode(path).startswith(self.folder)

    def hook(self, event, args):
        """An audit hook: Python tells it about each call before it is made."""
        if self.paused:
            return
        if event == "open":
            path, _, flags = args
            writing = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            if self.watched(path) and writing and not os.fsdecode(path).endswith(".lock"):
                self.strike()
        elif event in CHANGES and self.watched(args[0]):
            self.strike()

    def install(self):
        """Watch this process from now on."""
        sys.addaudithook(self.hook)
        disk, fdopen, fsync = self, os.fdopen, os.fsync

        class Stream:
            """A file whose writes are counted."""

            def __init__(self, file):
                self._file = file

            def __getattr__(self, name):
                return getattr(self._file, name)

            def __enter__(self):
                return self

            def __exit__(self, *_):
                self._file.close()

            def write(self, data):
                data = bytes(data)
                disk.strike(lambda: (self._file.write(data[: len(data) // 2]), self._file.flush()))
                return self._file.write(data)

        def opened(handle, mode="r", *args, **kwargs):
            file = fdopen(handle, mode, *args, **kwargs)
            return Stream(file) if mode in ("wb", "r+b") else file

        def flushed(handle):
            disk.strike()
            fsync(handle)

        os.fdopen, os.fsync = opened, flushed


def child(command, folder, at=0, fault="kill", seconds=600):
    """Give a command in a process of its own; returns how it ended, what it said, and the calls that it made."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(reader)
        said, code, disk = io.StringIO(), 3, Disk(folder, at, fault)
        try:
            disk.install()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = command()
        except BaseException:
            said.write(traceback.format_exc())
        os.write(writer, json.dumps([code, said.getvalue()[-4000:], disk.calls]).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        answer = stream.read()
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        return -os.WTERMSIG(status), "", 0
    return tuple(json.loads(answer))


def check(scenario, cases, fault, seed=0):
    """Interrupt a scenario at `cases` of its calls, spread evenly; returns tried cases, failures in words, and all calls."""
    base = Path(tempfile.mkdtemp(prefix=f"{scenario.__name__}-"))
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            scenario.prepare(base / "warm")
            assert scenario.command(base / "warm") == 0
        whole = base / "whole"
        scenario.prepare(whole)
        code, said, calls = child(lambda: scenario.command(whole), whole)
        assert code == 0, said
        expected = scenario.outcome(whole)
        rng, wrong = random.Random(seed), []
        turns = [1 + (i * calls) // cases if cases <= calls else rng.randint(1, calls) for i in range(cases)]
        for i, at in enumerate(turns):
            folder = base / str(i)
            scenario.prepare(folder)
            code, said, _ = child(lambda folder=folder: scenario.command(folder), folder, at, fault)
            if fault == "kill" and code != -signal.SIGKILL:
                wrong.append(f"call {at}: not killed, {code} {said}")
            if fault != "kill" and (code != 2 or said.count("error:") != 1 or "Traceback" in said):
                wrong.append(f"call {at}: exit code {code}, {said}")
            code, said, _ = child(lambda folder=folder: scenario.command(folder), folder)
            if code != 0:
                wrong.append(f"call {at}, again: exit code {code}, {said}")
            else:
                found = scenario.outcome(folder)
                wrong += [f"call {at}: {name} differs" for name in expected if found.get(name) != expected[name]]
            shutil.rmtree(folder)
        return len(turns), wrong, calls
    finally:
        shutil.rmtree(base)


if __name__ == "__main__":
    from tests.faults import scenarios

    asked, failed = sys.argv[1:], False
    for name, cases, fault in zip(asked[::3], asked[1::3], asked[2::3], strict=True):
        began = time.process_time() + sum(os.times()[2:4])
        tried, wrong, calls = check(getattr(scenarios, name), int(cases), fault)
        seconds = round(time.process_time() + sum(os.times()[2:4]) - began)
        print(f"| {name} | {calls} | {fault} | {tried} | {len(wrong)} | {seconds} s", *wrong[:5], sep="\n", flush=True)
        failed |= bool(wrong)
    sys.exit(failed)
