"""`python -m train <command> [options]`: learn a task, make the paper's figures, or measure the speed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import threadpoolctl
import torch
import tyro

from torchds.errors import TorchdsError
from train import benchmark
from train.beyond.command import Beyond
from train.compare.command import Compare
from train.deep_rl.command import DeepRL
from train.folder import Interrupted
from train.hardware.command import Hardware
from train.lasa.command import BenchmarkLasa
from train.learning.run import run
from train.options import TASK_OPTIONS, RunOptions
from train.paper.claims.command import Claims
from train.paper.figures.command import Figures
from train.view import View


def main() -> int:
    """Parse the command line and do what it says; errors of the user come back as one line and exit code 2."""
    commands: dict[str, Callable[..., Any]] = {
        **TASK_OPTIONS,
        "claims": Claims,
        "deep_rl": DeepRL,
        "figures": Figures,
        "hardware": Hardware,
        "view": View,
        "compare": Compare,
        "beyond": Beyond,
        "benchmark": benchmark.Benchmark,
        "benchmark_lasa": BenchmarkLasa,
    }
    options: Any = tyro.extras.subcommand_cli_from_dict(
        commands, prog="python -m train", description=__doc__, config=(tyro.conf.FlagConversionOff,)
    )
    # Small tensors: a second thread costs more than it gives, and results depend on one only.
    torch.set_num_threads(1)
    try:
        with threadpoolctl.threadpool_limits(1):  # numpy and scikit-learn
            run(options) if isinstance(options, RunOptions) else options.main()
    except TorchdsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except Interrupted as stop:
        print(stop, file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
