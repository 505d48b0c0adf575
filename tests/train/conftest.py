"""Shared by the tests of the commands."""

import pytest

from tests.fitted import fitted_once  # noqa: F401
from train.learning import run


@pytest.fixture
def undrawn(monkeypatch):
    """A run leaves no figures, which take longer than a few updates."""
    monkeypatch.setattr(run.figures, "of_run", lambda learner: {})
