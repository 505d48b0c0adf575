"""A point mass among walls, against the same motion without walls and a geometry that can be read off."""

from dataclasses import replace

import pytest
import torch

from tasks.sketch import Problem, Sketch
from tasks.sketch.walled import Walled
from torchds import Walls, testing
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled
from torchds.plants import PointMass

LINE = Problem(  # along x1, while a force pushes the mass to where x2 is large
    strokes=[[(j / 29, 2 * j / 29, 0.0) for j in range(30)]],
    samples=40,
    components=2,
    body={"field": "constant", "force": (0.0, 100.0), "stiffness": 100.0},
)
CEILING = ((-9.0, 0.3), (9.0, 0.3))


def several(problem, execution):
    """The task, and roll-outs of three policies of it that drift to different sides."""
    task = Sketch.of(replace(problem, body={**problem.body, "execution": execution}))()
    policy = task.policy().expand(3)
    with torch.no_grad():
        policy.b[..., 1] += torch.tensor([[-1.0], [0.0], [1.0]])
        return task, task.rollout(policy)


@pytest.mark.parametrize("execution", ["open", "closed", "passive"])
def test_the_mass_rests_where_its_step_would_meet_a_wall_and_the_reference_goes_on(execution):
    _, free = several(LINE, execution)
    task, path = several(replace(LINE, walls=[CEILING]), execution)
    assert task.stop is None and not task.differentiable
    for run in range(3):
        met = int((free.x[run, :, 1] >= 0.3).double().argmax())
        assert met > 1  # the step that is not taken
        assert torch.allclose(path.x[run, :met], free.x[run, :met], rtol=0, atol=1e-12)
        assert (path.x[run, met:] == path.x[run, met - 1]).all() and (path.v[run, met - 1 :] == 0).all()
        assert path.plant.held[run, :, 0].tolist() == [j >= met for j in range(path.x.shape[1])]
    if execution == "open":
        assert torch.allclose(path.reference, free.reference, rtol=0, atol=1e-12)


def test_a_wall_that_the_reference_alone_crosses_holds_nothing():
    _, free = several(LINE, "open")
    _, path = several(replace(LINE, walls=[((1.0, -0.2), (1.0, 0.2))]), "open")
    crossed = (path.reference[1, :, 0] > 1.0).any() and path.reference[1, :, 1].abs().max() < 0.1
    assert crossed and torch.allclose(path.x[1], free.x[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "plant", [ImpedanceControlled(PointMass(), 100.0), PassiveControlled(PointMass(damping=0.5), 20.0, 5.0)]
)
def test_it_is_a_plant_as_others_are(plant):
    wall = Walls(torch.tensor([[[0.15, -1.0], [0.15, 1.0]]], dtype=torch.float64))
    starts = torch.tensor([[0.0, 0.0], [0.1, -0.3], [0.4, 0.2]], dtype=torch.float64)
    testing.check_plant(Walled(plant, wall), starts)
