"""The options of digging, which need none of its packages."""

import subprocess
import sys

import pytest

from tasks.lwr_digging import DiggingOptions
from tasks.registry import options_of
from torchds.errors import InvalidArgumentError


class Given(DiggingOptions):
    """The options with what a task needs, and nothing behind it."""

    name = "given"

    def default_demonstrations(self):
        raise NotImplementedError

    def cost_terms(self, path):
        raise NotImplementedError


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"initial_stiffness": 49.0}, r"within \[50, 700\] N/m, got 49"),
        ({"initial_stiffness": float("nan")}, "initial_stiffness has to be within"),
        ({"grains": "sand"}, "grains has to be 'fine' or 'coarse', got 'sand'"),
        ({"seconds": 0.5}, "seconds has to be above 0.5, .*got 0.5"),
        ({"threads": 0}, "threads at least 1"),
        ({"seed": -1}, "seed at least 0"),
    ],
)
def test_values_out_of_range_are_refused(options, words):
    with pytest.raises(InvalidArgumentError, match=words):
        Given(**options)
    assert Given(initial_stiffness=50.0).seconds == 15.0


@pytest.mark.slow
def test_the_options_are_known_without_mujoco():
    assert options_of("lwr_digging") is DiggingOptions
    code = "import sys, tasks; tasks.options_of('lwr_digging'); sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
