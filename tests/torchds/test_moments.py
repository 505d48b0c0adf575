"""One step of a roll-out, open and closed loop."""

import torch
from torch.testing import assert_close

from torchds.moments import advance, begin, record, seen
from torchds.plants import PointMassState


class Recorder:
    """A plant that stays elsewhere and keeps its commands."""

    def __init__(self, at):
        self.at, self.commands = at, []

    def reset(self, x0):
        zero = torch.zeros_like(self.at)
        return PointMassState(self.at, zero, zero, zero, zero)

    def step(self, state, command):
        self.commands.append(command)
        return state


def test_in_open_loop_a_step_goes_on_from_the_reference():
    plant, v = Recorder(torch.full((2,), 7.0)), torch.tensor([1.0, 2.0])
    now = begin(torch.zeros(2), 2, plant=plant)
    for i in range(2):
        now = advance(now, v, None, 0.1 * i, 0.1, plant=plant)
    assert_close(now.x, 0.2 * v)
    first, second = plant.commands
    assert first.x_before.tolist() == [0, 0] and first.v_before.tolist() == [0, 0]
    assert torch.equal(second.x_before, first.x) and torch.equal(second.v_before, v)


def test_with_feedback_it_goes_on_from_where_the_plant_is_with_one_reference_for_the_step():
    plant, v = Recorder(torch.tensor([7.0, 8.0, 9.0])), torch.tensor([1.0, 2.0])
    now = begin(torch.zeros(2), 2, plant=plant)
    assert seen(now, plant, 0.0, 0.1).tolist() == [7, 8]
    for i in range(2):
        now = advance(now, v, None, 0.1 * i, 0.1, plant=plant, feedback=True)
    for command in plant.commands:
        assert_close(command.x, torch.tensor([7.1, 8.2]))
        assert torch.equal(command.x, command.x_before) and torch.equal(command.v, command.v_before)


def test_without_a_plant_the_reference_is_what_is_seen():
    now = begin(torch.ones(2), 2)
    assert torch.equal(seen(now, None, 0.0, 0.1), now.x)
    path = record([now, advance(now, torch.ones(2), None, 0.0, 0.5, feedback=True)], [torch.zeros(3)], [], 0.5)
    assert path.x.tolist() == [[1, 1], [1.5, 1.5]] and torch.equal(path.inputs, path.x[:-1])
