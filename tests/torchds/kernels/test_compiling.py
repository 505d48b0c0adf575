"""What a roll-out gives does not depend on the company."""

import itertools

import torch

from tests.torchds.kernels.comparison import needs_numba
from torchds import Bounds, rollout
from torchds.forces import DivergentForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

pytestmark = needs_numba


@torch.no_grad()
def test_the_bits_do_not_depend_on_the_company(random_policy, randn):
    policy, x0 = random_policy(4, 2, 2, 2, batch=(200,)), 0.5 * randn(3, 2)
    plant = ImpedanceControlled(PointMass(force=DivergentForce(torch.eye(2, dtype=torch.float64), 3.0)), low=0.1)
    options = {"n_steps": 200, "dt": 0.02, "stop": Bounds(-3.0, 3.0), "plant": plant, "backend": "fused"}
    together = rollout(policy, x0, **options)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        in_two = rollout(policy, x0, **options)
    finally:
        torch.set_num_threads(threads)
    for name in ("x", "v", "features", "resting", "stiffness", "reference"):
        a = getattr(together, name)
        assert torch.equal(a, getattr(in_two, name)), name
        for i, point in itertools.product((0, 57, 199), range(3)):
            alone = rollout(policy[i], x0[point], **options)
            assert torch.equal(a[i, point], getattr(alone, name)), name
