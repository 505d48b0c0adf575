"""The claims about noise: the size that is best, and what is exact for the imitated N."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from train.paper.claims import noise
from train.paper.measured.base import Setting

SETTING = Setting(20, 0, None)


@pytest.mark.parametrize(
    ("costs", "expected"),
    [
        ({0.01: 2.0, 0.8: 3.0}, [True, True]),
        ({0.01: 0.5, 0.8: 3.0}, [False, True]),
        ({0.01: 2.0, 0.8: 1.0}, [True, False]),
    ],
)
def test_the_usual_noise_has_to_end_below_less_and_more(costs, expected, monkeypatch):
    def letter(shape, runs, seed, noise=0.1):
        final = costs.get(noise, 1.0) + 0.01 * np.linspace(-1, 1, runs)
        return SimpleNamespace(history=SimpleNamespace(cost=[final], terms={}))

    monkeypatch.setattr(noise, "letter", letter)
    assert [check.holds for check in noise.noise_size("N", SETTING)] == expected


@pytest.mark.parametrize(("runs", "holds"), [(9, False), (10, True)])
def test_half_of_the_policies_have_to_diverge_from_somewhere(runs, holds, monkeypatch):
    diverged = torch.zeros(20, 100, dtype=torch.bool)
    diverged[:runs, 3] = True
    monkeypatch.setattr(noise, "letter", lambda *_: None)
    monkeypatch.setattr(noise, "diverging", lambda learner: diverged)
    (check,) = noise.unstable("N", SETTING)
    assert (
        check.holds == holds
        and f"{runs} of 20" in check.what
        and f"({runs / 20:.0f} % of all 2000 motions diverge)" in check.what
    )


@pytest.mark.slow
def test_one_gaussian_alone_has_the_desired_noise_at_its_centre_and_uniform_noise_grows():
    alone, together = noise.centres(SETTING)
    assert alone.holds and alone.n == together.n == 4
    assert all(check.holds for check in noise.uniform(SETTING)[:1])  # over the map
    centre, moment = noise.half(SETTING)
    assert centre.n == moment.n == len(noise.imitated()[1])
