"""Training commands: python -m train <task> [options]."""

import importlib.util
import sys

from torchds.errors import MissingPackageError

for _package, _module in (
    ("matplotlib", "matplotlib"),
    ("pillow", "PIL"),
    ("tensorboard", "tensorboard"),
    ("threadpoolctl", "threadpoolctl"),
    ("tqdm", "tqdm"),
    ("tyro", "tyro"),
):
    if importlib.util.find_spec(_module) is None:
        _error = MissingPackageError(_package, "train", "python -m train")
        if sys.argv[0] == "-m":  # the command itself: one line, as for all errors of its user
            print(f"error: {_error}", file=sys.stderr)
            sys.exit(2)
        raise _error
