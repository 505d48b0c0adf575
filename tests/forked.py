"""Real processes that are forked from the test, so that everything is imported and compiled in them."""

import contextlib
import os
import socket
import sys
import traceback


def forked(size, work):
    """Call work(rank) in `size` processes as torchrun starts them; returns how they ended and what they wrote on stderr."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    started = []
    for rank in range(size):
        reader, writer = os.pipe()
        if (pid := os.fork()) == 0:
            code = 1
            try:
                os.dup2(writer, 2)
                sys.stderr = os.fdopen(2, "w", closefd=False)
                there = {"RANK": rank, "WORLD_SIZE": size, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
                os.environ.update({name: str(value) for name, value in there.items()})
                with contextlib.redirect_stdout(None):
                    work(rank)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                if "coverage" in sys.modules and (looking := sys.modules["coverage"].Coverage.current()):
                    looking.stop()
                    looking.save()  # in a file of this process, since it ends without a word
                sys.stderr.flush()
                os._exit(code)
        os.close(writer)
        started.append((pid, reader))
    ended = []
    for pid, reader in started:
        with os.fdopen(reader) as stream:
            said = stream.read()
        ended.append((os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), said))
    return ended
