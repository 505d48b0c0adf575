"""Commands of a file, one a line: `python -m tests.typed < FILE` does what `python -m train` does with each of them.

Each is given in a fork of one process, so that everything is imported once; the first that fails ends it.
"""

import os
import shlex
import sys
import traceback

import scipy.stats  # noqa: F401
import sklearn.mixture  # noqa: F401
import torch._dynamo  # noqa: F401  # by the first optimizer

from train import __main__ as train_main


def typed(words):
    """The exit code of a command in a process of its own, and the seconds that it kept a core busy."""
    sys.stdout.flush()
    if (pid := os.fork()) == 0:
        code = 1
        try:
            sys.argv = ["train", *words]
            code = train_main.main()
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    _, status, used = os.wait4(pid, 0)
    return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime


if __name__ == "__main__":
    for line in sys.stdin:
        print(f"python -m train {line.strip()}")
        code, seconds = typed(shlex.split(line))
        if code:
            sys.exit(f"ended with {code}: python -m train {line.strip()}")
        print(f"took {seconds:.1f} s")
