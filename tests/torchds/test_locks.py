"""One writer at a time, also between processes, and a lock that dies with its process."""

import os
import signal
import subprocess
import sys

import pytest

from torchds.errors import FileError
from torchds.locks import one_writer

HOLD = """
import sys, time
from torchds.locks import one_writer
with one_writer(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


def test_the_second_writer_is_told_who_works_there(tmp_path):
    with (
        one_writer(tmp_path),
        pytest.raises(FileError, match=rf"process {os.getpid()} on .* since"),
        one_writer(tmp_path),
    ):
        pass
    with one_writer(tmp_path):
        pass


@pytest.mark.slow
def test_a_killed_process_leaves_no_lock(tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(FileError, match=f"process {other.pid}"), one_writer(tmp_path):
            pass
        other.send_signal(signal.SIGKILL)
        other.wait()
        with one_writer(tmp_path):
            pass


def test_a_folder_that_is_gone_and_a_link_in_its_place_are_refused(tmp_path):
    with pytest.raises(FileError, match="cannot be locked"), one_writer(tmp_path / "gone"):
        pass
    (tmp_path / ".lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError, match="cannot be locked"), one_writer(tmp_path):
        pass
