"""Programs that are called, and what they say where they fail."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchds.errors import TorchdsError


def printed(command: Sequence[str | Path], **options: Any) -> str:
    """What a program prints, with `options` of `subprocess.run`.

    Raises:
        TorchdsError: it failed; the message has its first line that names an error, or else its last.
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()] or ["it says nothing"]
        why = next((line for line in lines if re.search(r"(?i)error: ", line)), lines[-1])
        raise TorchdsError(f"{Path(command[0]).name} ended with exit code {done.returncode}: {why}")
    return done.stdout
