"""Tasks by name: found, made with their options, registered once, and refused in words."""

import pytest

import tasks
from tasks.registry import options_of, task_class
from tests.motions import Short
from torchds import Demonstrations
from torchds.errors import InvalidArgumentError, UnknownNameError


class Bend(tasks.Task):
    """Complete, and never learned."""

    size: float = 1.0

    def default_demonstrations(self):
        return Demonstrations([[[0.0], [1.0], [1.5]]], dt=0.1)

    def cost_terms(self, path):
        return {"goal": path.x[..., -1, 0]}


def test_a_name_belongs_to_one_class(monkeypatch):
    monkeypatch.setattr(tasks.registry, "TASKS", dict(tasks.TASKS))
    assert tasks.register(Bend) is Bend and tasks.register(Bend) is Bend
    assert isinstance(tasks.make("bend", size=2.0), Bend)

    class Other(Bend):
        name = "via_point"

    with pytest.raises(
        InvalidArgumentError, match=r"the name 'via_point' of .*Other belongs to tasks.via_point.ViaPoint"
    ):
        tasks.register(Other)

    for none in (Bend(), int, "bend", None):
        with pytest.raises(InvalidArgumentError, match="register takes a class of tasks, got"):
            tasks.register(none)

    class Half(tasks.Task):
        pass

    with pytest.raises(
        InvalidArgumentError, match="Half is not complete: it has to define cost_terms, default_demonstrations"
    ):
        tasks.register(Half)


def test_an_unknown_task_lists_the_near_names():
    with pytest.raises(UnknownNameError, match=r"unknown task 'viapoint'\. Did you mean 'via_point'"):
        tasks.make("viapoint")


def test_an_unknown_convention_is_refused():
    with pytest.raises(InvalidArgumentError, match="'two_starts' has to be 'paper' or 'released', got 'draft'"):
        tasks.make("two_starts", convention="draft")


def test_a_name_and_a_convention_are_one_class():
    assert task_class("via_point") is tasks.ViaPoint is options_of("via_point")
    assert task_class("via_point", "released").convention == "released"
    assert options_of("tests.motions:Short") is Short is task_class("tests.motions:Short")


def test_an_option_that_a_task_does_not_have_is_refused_with_those_it_has():
    with pytest.raises(
        InvalidArgumentError, match="has no option shapes, size; it has shape, system, demonstrations, mixture, conv"
    ):
        tasks.make("via_point", size=1, shapes="N")
