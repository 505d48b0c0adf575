"""One drawing at a time is imitated, the latest one next."""

import pytest

from tests import drawn
from train.view.studio import imitator
from train.view.studio.worker import Failed


class Slow:
    """A worker that answers when the test says so."""

    def __init__(self, work):
        self.told, self.out, self.ended = [], [], False

    def tell(self, message):
        self.told.append(message)

    def answers(self):
        out, self.out = self.out, []
        return None if self.ended else out

    def end(self):
        self.ended = True

    def answer(self):
        number, problem = self.told[-1]
        self.out.append((number, Failed(str(problem.components))))


@pytest.fixture
def asked(monkeypatch):
    monkeypatch.setattr(imitator, "Worker", Slow)
    return imitator.Imitator()


def test_of_many_drawings_while_it_works_only_the_last_one_is_told(asked):
    worker = asked._worker
    for k in range(1, 8):
        asked.ask(drawn.problem(components=k))
    assert [problem.components for _, problem in worker.told] == [1] and asked.awaited
    worker.answer()
    assert asked.heard() is None and asked.awaited  # the answer is of an earlier drawing
    assert [problem.components for _, problem in worker.told] == [1, 7]
    worker.answer()
    assert asked.heard() == Failed("7") and not asked.awaited and asked.heard() is None


def test_what_is_not_asked_any_more_is_not_answered(asked):
    asked.ask(drawn.problem())
    asked.ask(None)
    asked._worker.answer()
    assert asked.heard() is None and not asked.awaited


def test_one_that_was_killed_is_replaced_and_asked_again(asked):
    asked.ask(drawn.problem(components=3))
    asked._worker.ended = True
    assert asked.heard() is None
    asked._worker.answer()
    assert asked.heard() == Failed("3")
    asked._worker.ended = True
    assert asked.heard() is None and asked._worker.told == []
