"""What the README shows is true."""

import re
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_first_example_runs_and_learns():
    example = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[1]
    space = {}
    exec(example, space)
    with torch.no_grad():
        assert float(space["closure"]()) < 1.0  # 3.1 before learning
