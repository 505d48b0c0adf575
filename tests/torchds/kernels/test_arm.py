"""The compiled law against that of torch, which makes it by other decompositions."""

import pytest
import torch

from tests.torchds.kernels.comparison import needs_numba
from torchds.cartesian import CartesianImpedance
from torchds.kinematics import Screws
from torchds.targets import PlaneReference, PoseReference

pytestmark = needs_numba


def screws(randn, slides=(), n=7):
    """Some arm of joints in all directions."""
    axes = randn(6, n)
    axes[3:] /= torch.linalg.vector_norm(axes[3:], dim=0)
    axes[3:, list(slides)] = 0.0
    home = torch.eye(4, dtype=torch.float64)
    home[:3, :3] = torch.linalg.qr(randn(3, 3))[0]
    home[:3, :3] *= torch.det(home[:3, :3])
    return Screws(axes, home)


def arms(randn, n, count):
    root = randn(count, n, n)
    mass = root @ root.mT + 0.5 * torch.eye(n, dtype=torch.float64)
    return randn(count, n), randn(count, n), mass, randn(count, n)


@pytest.mark.parametrize(("n", "slides"), [(7, ()), (7, (2, 5)), (6, ()), (9, (0,)), (3, ()), (1, (0,)), (7, range(5))])
@pytest.mark.parametrize("in_space", [True, False])
def test_it_is_the_law_of_torch(randn, n, slides, in_space):
    """Also where the tool cannot follow: arms of few joints, or of more slides than directions."""
    chain, state = screws(randn, slides, n), arms(randn, n, 20)
    if in_space:
        rotation = chain.jacobian(randn(20, n))[1][:, :3, :3]
        here = chain.jacobian(state[0], ret_eef_pose=True)[1][:3, :3, :3]
        rotation[:3] = here @ torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=torch.float64))  # half a turn away
        reference = PoseReference(randn(20, 3), rotation, randn(20, 3), randn(20, 3))
    else:
        reference = PlaneReference(randn(20, 2), randn(20), randn(20, 2), randn(20))
    posture, options = randn(n), {"torque_limit": [30.0] * n, "start_within": None}
    made = [CartesianImpedance(chain, posture, **options, backend=backend) for backend in ("eager", "fused")]
    for s in (300.0, 100 * randn(20).abs(), 0.0):
        eager, fused = (control(*state, reference, s) for control in made)
        assert torch.equal(eager.saturated, fused.saturated)
        for name in ("torque", "pose", "error", "nullspace"):
            one, other = getattr(eager, name), getattr(fused, name)
            torch.testing.assert_close(other, one, rtol=1e-8, atol=1e-8, msg=lambda m, name=name: f"{name}: {m}")
