"""The claims about stable exploration find out what is wrong."""

import pytest

from torchds.exploration import Stable
from train.paper.claims import stable
from train.paper.measured.base import Setting


@pytest.mark.parametrize(("factor", "fails"), [(1.01, "stable with"), (0.98, "unstable with")])
@pytest.mark.slow
def test_a_shrinkage_that_is_off_is_found_out(factor, fails, monkeypatch):
    setting = Setting(3, 0, None)
    assert all(check.holds for check in stable.shrinkage(setting))
    true = Stable.shrinkage
    monkeypatch.setattr(Stable, "shrinkage", lambda A, S: factor * true(A, S))
    failed = [check.what for check in stable.shrinkage(setting) if not check.holds]
    assert failed and any(fails in what for what in failed)
