"""Stop conditions, forces and plants as a GPU makes them, by Triton's interpreter, against the eager loop."""

import pytest
import torch

from tests.torchds.kernels.comparison import both, needs_numba
from tests.torchds.kernels.interpreted import interpreter  # noqa: F401
from tests.torchds.kernels.test_cpu import PUSH
from torchds import Bounds, Walls, disturbances
from torchds.forces import ConstantForce, DivergentForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

pytestmark = [needs_numba, pytest.mark.slow, pytest.mark.no_cover]

SQUARE = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], dtype=torch.float64)
LINE = torch.stack([torch.linspace(-2, 2, 6), torch.sin(torch.linspace(-2, 2, 6))], -1).double()
FORCES = {
    "constant": ConstantForce(PUSH[1]),
    "per point, half-plane": ConstantForce(PUSH, border=-0.5),
    "half-plane below": ConstantForce(PUSH[1], border=-0.5, axis=-1),
    "radial": DivergentForce(LINE, 3.0),
    "normal": DivergentForce(LINE, 3.0, along_normal=True),
}


@pytest.mark.parametrize(
    "stop",
    [Bounds(-1.5, torch.tensor([1.0, 0.9]).double()), Walls(torch.stack([SQUARE, SQUARE.roll(-1, 0)], 1))],
)
def test_stop_conditions(random_policy, randn, stop):
    path = both(random_policy(3, 2, 2, 1, batch=(20,)), 0.4 * randn(2, 2), n_steps=12, dt=0.05, stop=stop)
    assert path.stopped.any() and not path.stopped.all()


@pytest.mark.parametrize("force", FORCES.values(), ids=FORCES)
def test_forces(random_policy, randn, force):
    policy = random_policy(2, 2, 2, 2, batch=(6,))
    plant = ImpedanceControlled(PointMass(1.3, 0.7, force), low=0.2, high=0.4)
    path = both(policy, 0.5 * randn(2, 2), n_steps=6, dt=0.1, plant=plant)
    assert (path.plant.force[..., 1:, :] != 0).any()


@pytest.mark.parametrize("form", ["implicit", "explicit"])
@pytest.mark.parametrize(
    "options",
    [{"low": 0.2, "high": 0.4}, {"max_rate": 2.0, "rows": (1, 0)}, {"stiffness": 7.0}, {"stiffness": PUSH.abs() + 1.0}],
)
def test_kinds_of_stiffness(random_policy, randn, form, options):
    policy = random_policy(2, 2, 2, 2, batch=(5,))
    plant = ImpedanceControlled(PointMass(1.3, 0.7), form=form, **options)
    both(policy, 0.5 * randn(2, 2), n_steps=6, dt=0.1, plant=plant, stop=Bounds(-1.0, 1.0))


def test_noise_of_sensors_and_pushes(random_policy, randn):
    drawn = disturbances.draw((5, 2, 2), 6, 0.1, sensor=0.1, push=2.0, generator=torch.Generator().manual_seed(0))
    plant = ImpedanceControlled(PointMass(1.3, 0.7), low=0.2, high=4.0, disturbance=drawn)
    both(random_policy(2, 2, 2, 2, batch=(5,)), 0.5 * randn(2, 2), n_steps=8, dt=0.1, plant=plant)
