"""Property tests by numbers: few fixed cases in every run of the tests, many fresh ones in `make fuzz`."""

import functools
import os
import time
from collections import Counter

from hypothesis import HealthCheck, given, settings

CASES = int(os.environ.get("TORCHDS_FUZZ", "0"))
"""Cases of each property in `make fuzz`, with seeds of their own; 0 for the fixed ones."""

LONGEST = 2.0
"""Seconds that a case may take."""

TRIED: Counter[str] = Counter()
"""Cases tried so far, by file."""


def fuzz(usual=25, **strategies):
    """Hold a property for drawn cases, each at most two seconds long.

    Args:
        usual: cases in a run of the tests.
        **strategies: what the arguments of the test are drawn from.
    """

    def decorate(test):
        @functools.wraps(test)
        def counted(*args, **kwargs):
            TRIED[test.__module__.rpartition(".")[2]] += 1
            for last in (False, True):  # what is imported or compiled in the first of its kind is no hang
                began = time.process_time()  # of this process: a busy machine is none either
                test(*args, **kwargs)
                if time.process_time() - began < LONGEST:
                    return
                assert not last, f"a case took more than {LONGEST} s"

        run = settings(
            max_examples=CASES or usual,
            derandomize=not CASES,
            database=None,
            deadline=None,
            suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
        )
        return run(given(**strategies)(counted))

    return decorate
