"""The claim that noise of the system does harm, on costs made up for it."""

from types import SimpleNamespace

import numpy as np
import pytest

from train.paper.claims import limits
from train.paper.measured.base import Setting


@pytest.mark.parametrize(("harm", "holds"), [(0.5, True), (0.0, False), (-0.5, False)])
def test_both_force_fields_have_to_end_higher_with_noise(harm, holds, monkeypatch):
    def learned(task, runs, seed, sensor_noise=0.0, pushes=0.0):
        end = 1.0 + 0.1 * np.linspace(-1, 1, runs) + harm * (sensor_noise > 0 and pushes > 0)
        return SimpleNamespace(history=SimpleNamespace(cost=[end], terms={}))

    monkeypatch.setattr(limits, "learned", learned)
    checks = limits.noisy_trials(Setting(20, 0, None))
    assert [check.holds for check in checks] == [holds, holds]
    assert [check.what.split(",")[0] for check in checks] == ["divergent_field", "half_plane_force"]
