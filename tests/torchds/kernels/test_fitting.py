"""What does not fit into compiled loops is made eagerly, and refused where "fused" is asked for."""

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import needs_numba
from torchds import Bounds, GMRPolicy, rollout
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

pytestmark = needs_numba


def refuses(*words):
    return pytest.raises(torchds.errors.InvalidArgumentError, match=".*".join(words))


class Changed(GMRPolicy):
    def features(self, x):
        return 2.0 * super().features(x)


def test_what_does_not_fit_is_eager_and_refused_where_fused_is_asked_for(random_policy, randn):
    policy, x0 = random_policy(3), randn(2)
    changed = random_policy(3)
    changed.__class__ = Changed

    class Boxed(Bounds):
        pass

    cases = [
        (policy, {"shift": lambda t: torch.zeros(2, dtype=torch.float64)}, "a function of time"),
        (policy, {"stop": lambda x, x_next: x[..., 0] > 9.0}, "the stop condition function has no scalar step"),
        (policy, {"stop": Boxed(-9.0, 9.0)}, "the stop condition Boxed has no scalar step"),
        (
            policy,
            {"plant": ImpedanceControlled(PointMass(force=lambda t, x, v: -x), 1.0)},
            "ImpedanceControlled has no",
        ),
        (changed, {}, "Changed makes its outputs in a way of its own"),
    ]
    for system, options, reason in cases:
        with torch.no_grad():
            path = rollout(system, x0, 5, 0.1, **options)
            assert torch.equal(path.x, rollout(system, x0, 5, 0.1, **options, backend="eager").x)
            with refuses("backend='fused' cannot make this roll-out", reason):
                rollout(system, x0, 5, 0.1, **options, backend="fused")
    with refuses("gradients through a plant"):
        rollout(policy, x0, 5, 0.1, plant=ImpedanceControlled(PointMass(), 1.0), backend="fused")


@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # inside of torch, in forward mode
@pytest.mark.slow
def test_function_transforms_take_the_eager_loop(random_policy, randn):
    policy, x0, steps = random_policy(3), randn(2), {"n_steps": 3, "dt": 0.1}

    def end(x):
        return rollout(policy, x, **steps).x[-1]

    J = torch.func.jacrev(end)(x0)
    torch.testing.assert_close(torch.func.jacfwd(end)(x0), J)
    assert torch.equal(torch.func.vmap(end)(x0.expand(4, 2))[2], rollout(policy, x0, **steps, backend="eager").x[-1])
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(x0, torch.ones_like(x0))
        tangent = torch.autograd.forward_ad.unpack_dual(end(dual)).tangent
    torch.testing.assert_close(tangent, J.sum(-1))


class Slower:
    """Passes everything on to a policy, but for the outputs."""

    def __init__(self, policy):
        self.policy = policy

    def __getattr__(self, name):
        return getattr(self.policy, name)

    def outputs(self, features, rows):
        return 0.5 * self.policy.outputs(features, rows)


class Elsewhere:
    """Passes everything on to a stop condition, but for the call."""

    def __init__(self, stop):
        self.stop = stop

    def __getattr__(self, name):
        return getattr(self.stop, name)

    def __call__(self, x, x_next):
        return self.stop(x + 1.0, x_next + 1.0)


@torch.no_grad()
def test_a_wrapper_is_not_taken_for_what_it_wraps(random_policy, randn):
    policy, x0 = random_policy(3), 0.1 * randn(2)
    for system, stop in ((Slower(policy), None), (policy, Elsewhere(Bounds(-1.0, 1.0)))):
        path, eager = (rollout(system, x0, 20, 0.1, stop=stop, backend=name) for name in ("auto", "eager"))
        assert torch.equal(path.x, eager.x)
        with refuses("backend='fused' cannot make this roll-out"):
            rollout(system, x0, 20, 0.1, stop=stop, backend="fused")
