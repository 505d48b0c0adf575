"""The mass that can be pulled at."""

import pytest
import torch

from tasks.sketch import Sketch
from tests import drawn
from torchds import rollout
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled
from torchds.plants import PointMass
from train.view.studio.pushing import DT, HAND, MASS, Pushed


@pytest.fixture(scope="module")
def motion():
    task = Sketch.of(drawn.problem())()
    return task.policy(), task.motion().x0


@pytest.mark.parametrize("execution", ["open", "closed", "passive"])
def test_without_a_hand_it_is_a_roll_out(motion, execution):
    policy, x0 = motion
    pushed = Pushed(policy, x0, execution, 150.0)
    for _ in range(20):
        pushed.go_on(5 * DT)
    mass = PointMass(MASS, 0.0)
    plant = ImpedanceControlled(mass, 150.0)
    if execution == "passive":
        plant = PassiveControlled(mass, 2 * 150.0**0.5)
    path = rollout(policy, x0, 100, DT, plant=plant, feedback=execution != "open", backend="eager")
    torch.testing.assert_close(pushed.at, path.x[-1].detach(), rtol=0, atol=1e-12)
    assert pushed.t == pytest.approx(1.0) and not pushed.lost


def test_a_hand_and_a_spring_end_where_their_forces_are_equal():
    task = Sketch.of(drawn.problem(condition="none"))()
    policy = task.policy()
    with torch.no_grad():  # it stays where it is
        policy.A.zero_()
        policy.b.zero_()
    pushed = Pushed(policy, task.motion().x0, "open", 200.0)
    hand = task.motion().x0 + torch.tensor([0.5, -0.2], dtype=torch.float64)
    pushed.hold(hand)
    for _ in range(40):
        pushed.go_on(0.1)
    expected = (200.0 * task.motion().x0 + HAND * hand) / (200.0 + HAND)
    torch.testing.assert_close(pushed.at, expected, rtol=0, atol=1e-6)
    assert list(pushed.applied) == [200.0, 200.0]
    pushed.hold(hand, 0.3)
    for _ in range(40):
        pushed.go_on(0.1)
    assert pushed.hand is None
    torch.testing.assert_close(pushed.at, task.motion().x0, rtol=0, atol=1e-6)


def test_in_open_loop_the_reference_rests_when_the_motion_is_over(motion):
    policy, x0 = motion
    pushed = Pushed(policy, x0, "open", 300.0, 0.5)
    pushed.go_on(0.5)
    end = pushed.reference
    for _ in range(30):
        pushed.go_on(0.1)
    assert pushed.reference.equal(end)
    torch.testing.assert_close(pushed.at, end, rtol=0, atol=1e-6)


def test_a_policy_with_a_stiffness_applies_its_own():
    task = Sketch.of(drawn.problem(body={"stiffness": 77.0}))()
    pushed = Pushed(task.policy(), task.motion().x0, "closed", 5.0)
    pushed.go_on(0.2)
    assert list(pushed.applied) == pytest.approx([77.0, 77.0])


def test_a_motion_that_goes_nowhere_is_said_to_be_lost():
    task = Sketch.of(drawn.problem())()
    policy = task.policy()
    with torch.no_grad():
        policy.A.copy_(1e6 * torch.eye(2, dtype=torch.float64))
    pushed = Pushed(policy, task.motion().x0, "closed")
    for _ in range(30):
        pushed.go_on(0.1)
    assert pushed.lost
