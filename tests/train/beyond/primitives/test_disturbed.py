"""Disturbed motions: what is done to them is done, and what is measured is that."""

import pytest
import torch

import tasks
from tests.motions import Short
from train.beyond.primitives.disturbed import Disturbance, disturbances, follow, measures

NONE = torch.zeros(1, 2, dtype=torch.float64)


@pytest.fixture(scope="module", params=["gmr", "dmp"])
def task(request):
    return Short(system=request.param)


@pytest.mark.slow
def test_undisturbed_it_is_the_roll_out_of_the_task(task):
    policy = task.policy().expand(3)
    x = follow(policy, task.motion(), Disturbance("none", NONE, NONE))
    torch.testing.assert_close(x[:, 0], task.rollout(policy).x.detach(), rtol=0, atol=1e-9)


def test_a_push_is_a_jump_and_the_policy_goes_on_from_there(task):
    motion, push = task.motion(), torch.tensor([[1.0, 0.0], [0.0, 2.0]], dtype=torch.float64)
    policy = task.policy()
    x, whole = (follow(policy, motion, Disturbance("", NONE, by, at=7)) for by in (push, NONE))
    torch.testing.assert_close(x[:, :8], whole[:, :8].expand(2, -1, -1), rtol=0, atol=1e-9)
    jump = (x[:, 8] - whole[0, 8]) - push
    if task.system == "dmp":  # place enters the velocity one step later
        assert jump.abs().max() < 1e-9
    else:
        torch.testing.assert_close(x[:, 8], x[:, 7] + push + motion.dt * policy(x[:, 7] + push), rtol=0, atol=1e-9)


def test_a_dynamical_system_that_is_held_goes_on_as_if_nothing_had_been():
    task = Short()
    whole = follow(task.policy(), task.motion(), Disturbance("", NONE, NONE))
    x = follow(task.policy(), task.motion(), Disturbance("", NONE, NONE, at=6, held=4, late=4))
    assert torch.equal(x[:, :7], whole[:, :7]) and torch.equal(x[:, 10:], whole[:, 6:])
    assert torch.equal(x[:, 6:11], whole[:, 6:7].expand(-1, 5, -1))


def test_the_clock_of_a_primitive_that_is_held_goes_on():
    """Set back to rest at the same place after as many steps of the phase."""
    task = Short(system="dmp")
    policy, (x0, _, dt) = task.policy(), task.motion()
    x = follow(policy, task.motion(), Disturbance("", NONE, NONE, at=6, held=4, late=4))
    now = policy.begin(x0)
    for step in range(11):
        now = policy.step(now._replace(z=0 * now.z) if step == 10 else now, dt)
        if step == 5:
            place = now.y
        if 6 <= step < 10:
            now = now._replace(y=place)
    torch.testing.assert_close(x[0, 10], place, rtol=0, atol=1e-12)
    torch.testing.assert_close(x[0, 11], now.y, rtol=0, atol=1e-9)


def test_measures_of_motions_that_are_known():
    """A straight line, and the same one unit beside it and half as fast."""
    t = torch.linspace(0, 4, 9, dtype=torch.float64)
    whole = torch.stack([t, 0 * t], -1)[None]
    slow = torch.stack([t / 2, 0 * t + 1], -1)[None]
    goal, via_points = torch.tensor([4.0, 0.0]).double(), torch.tensor([[1.0, 1.2], [3.0, 1.0]]).double()
    found = measures(slow, whole, Disturbance("", NONE, NONE), goal, via_points)
    assert float(found.passed) == 0.5
    assert float(found.end) == pytest.approx(5**0.5)
    between = torch.minimum(t[1:] / 2 % 0.5, 0.5 - t[1:] / 2 % 0.5)  # to the nearest of the places, half a unit apart
    assert float(found.path) == pytest.approx(float((1 + between**2).sqrt().mean()))
    assert float(found.clock) == pytest.approx(float((1 + (t[1:] / 2) ** 2).sqrt().mean()))
    same = measures(whole, whole, Disturbance("", NONE, NONE), goal, via_points)
    assert [float(same.end), float(same.path), float(same.clock)] == [0.0, 0.0, 0.0]


def test_disturbances_are_as_large_and_as_long_as_asked_for():
    motion = tasks.make("via_point").motion()
    none, pushed, held, begun, left = disturbances(motion, 1.5, 8.0)
    assert none.name == "none" and not none.push.any() and not none.start.any()
    for around in (pushed.push, begun.start):
        assert around.shape == (8, 2)
        torch.testing.assert_close(around.norm(dim=-1), torch.full((8,), 1.5).double(), rtol=1e-12, atol=0)
        assert around.sum(0).abs().max() < 1e-12
    assert (pushed.at, held.at, held.held, held.late, left.late) == (80, 80, 40, 40, 200)
