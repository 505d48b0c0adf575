"""Point masses under impedance control and in force fields, fused and eager."""

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import DT, T, both, needs_numba
from torchds import Bounds, rollout
from torchds.forces import ConstantForce, DivergentForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

pytestmark = needs_numba

LINE = torch.stack([torch.linspace(-3, 3, 50), torch.sin(torch.linspace(-3, 3, 50))], -1).double()
PUSH = torch.tensor([[0.0, 0.0], [1.0, -2.0]], dtype=torch.float64)
FORCES = {
    "none": None,
    "constant": ConstantForce(PUSH[1]),
    "per point": ConstantForce(PUSH),
    "half-plane": ConstantForce(PUSH, border=0.2),
    "half-plane below": ConstantForce(PUSH[1], border=-0.2, axis=-1),
    "radial": DivergentForce(LINE, 3.0),
    "normal": DivergentForce(LINE, 3.0, along_normal=True),
}


@pytest.mark.parametrize("force", FORCES.values(), ids=FORCES)
@pytest.mark.parametrize("form", ["implicit", "explicit"])
@pytest.mark.slow
def test_point_masses_under_impedance_control(random_policy, randn, form, force):
    policy = random_policy(4, 2, 2, 2, batch=(6,))
    plant = ImpedanceControlled(PointMass(1.3, 0.7, force), form=form, low=0.2, high=0.4)
    path = both(policy, 0.5 * randn(2, 2), plant=plant, stop=Bounds(-3.0, 3.0))
    assert (path.plant.stiffness == 0.2).any() and (path.plant.stiffness == 0.4).any()


@pytest.mark.parametrize("form", ["implicit", "explicit"])
@pytest.mark.parametrize(
    "options",
    [{"max_rate": 2.0}, {"rows": (1, 0)}, {"rows": (0, 0)}, {"stiffness": 7.0}, {"stiffness": PUSH.abs() + 1.0}],
)
def test_kinds_of_stiffness(random_policy, randn, form, options):
    policy = random_policy(4, 2, 2, 2, batch=(5,))
    both(policy, 0.5 * randn(2, 2), plant=ImpedanceControlled(PointMass(), form=form, **options))


@pytest.mark.slow
def test_one_stiffness_row_for_all_axes_and_none(random_policy, randn):
    both(random_policy(3, 2, 2, 1, batch=(5,)), 0.5 * randn(2), plant=ImpedanceControlled(PointMass(), low=0.1))
    both(random_policy(3, 2, 2, 0), 0.5 * randn(2), plant=ImpedanceControlled(PointMass(), stiffness=3.0))
    for backend in ("fused", "auto", "eager"):
        with pytest.raises(
            torchds.errors.InvalidArgumentError, match="a policy without stiffness cannot control 2 axes"
        ):
            rollout(random_policy(3), randn(2), T, DT, plant=ImpedanceControlled(PointMass()), backend=backend)
