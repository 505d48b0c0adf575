"""Settings of learners."""

import pytest

pytest.importorskip("nicegui")

from types import SimpleNamespace

from train.view.studio.running import hurry


class Learner:
    def __init__(self, running):
        self.running, self.paces = running, []

    def go(self, pace):
        self.paces.append(pace)


def test_another_pace_is_for_those_who_learn_already():
    sides = [Learner(True), Learner(False)]
    hurry(SimpleNamespace(sides=sides), 7.0)
    assert [side.paces for side in sides] == [[7.0], []]
