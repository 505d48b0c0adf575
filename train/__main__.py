"""`python -m train <command> [options]`: learn a task, make the paper's figures, or measure the speed.

A task of yours is named by where it stands: FILE.py:NAME or MODULE:NAME of a class, PROBLEM.json of a drawn problem, in
place of the command.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import threadpoolctl
import torch
import tyro

import tasks
from tasks.loading import is_spec
from torchds.errors import TorchdsError
from torchds.files import reason
from train.benchmark.command import Benchmark
from train.benchmark.scale.command import Scale
from train.beyond.command import Beyond
from train.beyond.primitives.command import Primitives
from train.compare.command import Compare
from train.compare.sweep.command import Sweep
from train.deep_rl.command import DeepRL
from train.folder import Interrupted
from train.hardware.arm import Arm
from train.hardware.command import hardware
from train.hardware.latency import Latency
from train.hardware.push import Push
from train.lasa.command import BenchmarkLasa
from train.learning.run import run
from train.options import RunOptions, options_class
from train.paper.claims.command import Claims
from train.paper.experiment import Digging
from train.paper.figures.command import Figures
from train.view.command import View
from train.view.studio.command import Studio


def given(arguments: Sequence[str]) -> set[str]:
    """Names of the options that a command line says."""
    return {word[2:].partition("=")[0].replace("-", "_") for word in arguments if word.startswith("--")}


def main() -> int:
    """Parse the command line and do what it says; errors of the user come back as one line and exit code 2."""
    commands: dict[str, Callable[..., Any]] = {
        **{name: options_class(name) for name in tasks.TASKS},
        "arm": Arm,
        "claims": Claims,
        "deep_rl": DeepRL,
        "digging": Digging,
        "figures": Figures,
        "hardware": hardware([]),
        "latency": Latency,
        "push": Push,
        "studio": Studio,
        "view": View,
        "compare": Compare,
        "sweep": Sweep,
        "scale": Scale,
        "beyond": Beyond,
        "primitives": Primitives,
        "benchmark": Benchmark,
        "benchmark_lasa": BenchmarkLasa,
    }
    # Small tensors: a second thread costs more than it gives, and results depend on one only.
    torch.set_num_threads(1)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without Unicode gets what it can show
            stream.reconfigure(errors="backslashreplace")
    return ended(lambda: command(commands))


def command(commands: dict[str, Callable[..., Any]]) -> None:
    """Do what the command line says."""
    arguments = sys.argv[1:]
    if arguments and is_spec(arguments[0]):
        options_of_task = options_class(arguments[0])
        arguments[0] = tasks.options_of(arguments[0]).name
        commands[arguments[0]] = options_of_task
    elif arguments[:1] == ["hardware"]:
        commands["hardware"] = hardware(arguments)
    options: Any = tyro.extras.subcommand_cli_from_dict(
        commands,
        prog="python -m train",
        description=__doc__,
        args=arguments,
        config=(tyro.conf.FlagConversionOff,),
    )
    with threadpoolctl.threadpool_limits(1):  # numpy and scikit-learn
        run(options, given(arguments)) if isinstance(options, RunOptions) else options.main()


def ended(call: Callable[[], object]) -> int:
    """The exit code of a command, whose errors are said in one line."""
    try:
        call()
    except TorchdsError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read what is printed has gone
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return 2
    except OSError as error:  # a disk that is full, read-only or gone, wherever it is met
        place = f"{error.filename}: " if error.filename is not None else ""
        print(f"error: {place}{reason(error)}", file=sys.stderr)
        return 2
    except Interrupted as stop:
        print(stop, file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
