"""Tasks that are kept between runs."""

import pytest

from train.learning import kept
from train.options import RunOptions, options_for


class Counter:
    """A task that goes on from trial to trial."""

    def __init__(self):
        self.n = 0

    def state_dict(self):
        return {"n": self.n}

    def load_state_dict(self, state):
        self.n = state["n"]


@pytest.fixture(autouse=True)
def made(monkeypatch):
    monkeypatch.setattr(kept, "_made", {})
    monkeypatch.setattr(RunOptions, "make_task", lambda options: Counter())


def test_a_task_is_the_same_one_as_if_new():
    task = kept.made(options_for("via_point"))
    task.n = 5
    assert kept.made(options_for("via_point", seed=3, optimizer="cma")) is task and task.n == 0


@pytest.mark.parametrize("other", [{"shape": "P"}, {"device": "cuda"}, {"convention": "released"}])
def test_other_options_have_another_task(other):
    assert kept.made(options_for("via_point", **other)) is not kept.made(options_for("via_point"))
