"""Recordings of motions in space that are other motions; those of a soft arm in gravel are tested in tests/train/hardware."""

import numpy as np
import pytest
import torch

from tests.torchds.sessions.motions import POSES
from torchds.sessions.questions import question

T, DT = 200, 0.01


def asked():
    t = torch.linspace(0, 1, T + 1, dtype=torch.float64)
    x = [
        torch.stack([0.3 * t, 0.2 * torch.sin(3 * t) + 0.03 * k * t, 0.1 * t**2, 0.5 * t, -0.3 * t, 0.2 * k * t], -1)
        for k in range(3)
    ]
    return torch.stack(x)


def names(measured):
    return {(found.name, found.rollouts) for found in question(POSES, [1, 2, 3], measured, asked(), DT) if found.gross}


def still(x):
    x[1] = x[1, :1]


def mirrored(x):
    x[1, :, 1] = 2 * x[1, 0, 1] - x[1, :, 1]


def turned(x):
    x[1, :, :2] = x[1, :, [1, 0]] * torch.tensor([-1.0, 1.0])


def double_speed(x):
    steps = np.arange(T + 1)
    x[1] = torch.from_numpy(np.column_stack([np.interp(2 * steps, steps, column) for column in x[1].numpy().T]))


def swapped(x):
    x[[0, 2]] = x[[2, 0]]


def copied(x):
    x[2] = x[1]


WRONG = {still: (2,), mirrored: (2,), turned: (2,), double_speed: (2,), swapped: (1, 3), copied: (2, 3)}


@pytest.mark.parametrize("change", WRONG)
def test_gross_errors_are_named(change):
    measured = asked() + 0.003 * torch.randn(3, T + 1, 6, generator=torch.Generator().manual_seed(0)).double()
    assert names(measured) == set()
    change(measured)
    assert names(measured) == {(change.__name__.replace("double_", ""), WRONG[change])}


def test_words_have_the_unit_and_the_column():
    measured = asked()
    mirrored(measured)
    (found,) = question(POSES, [1, 2, 3], measured, asked(), DT)
    assert "y is mirrored" in found.words and " m of a deviation of " in found.words
