"""What all parts of a page share."""

import pytest

pytest.importorskip("nicegui")

from types import SimpleNamespace

from train.view.studio.window import EVERYTHING, Window


def test_a_window_that_is_closed_lets_go_what_its_own_pointer_held():
    studio, done = SimpleNamespace(views=[]), []
    windows = [Window(studio) for _ in range(3)]
    studio.views += windows
    for i in range(2):
        windows[i].given_up = lambda i=i: done.append(i)
    windows[2].leave()
    assert done == [] and studio.views == windows[:2]
    windows[1].leave()
    assert done == [1] and studio.views == windows[:1]


def test_with_another_problem_everything_is_shown_anew():
    window = Window(SimpleNamespace())
    window.news("mass")
    assert window.waiting == {"mass"}
    window.news("problem")
    assert window.waiting == EVERYTHING
