import pytest
import torch

import tasks
from tasks.imitation import with_constant_stiffness, with_stiffness, without_stiffness
from torchds import Demonstrations, GMRPolicy
from torchds.errors import DemonstrationWarning, InvalidArgumentError


@pytest.mark.slow
def test_stiffness_that_was_demonstrated_is_used():
    """Eq. 34: the policy gives it where it was shown; the constant s⁰ is for motions without."""
    demos = tasks.make("divergent_field").demonstrations
    rising = [torch.stack([100 - 5 * d.x[:, 0], 50 + 0 * d.x[:, 0]], -1) for d in demos]
    shown = Demonstrations([d.x for d in demos], [d.v for d in demos], demos.dt, stiffness=rising, units="m")
    policy = tasks.make("divergent_field", demonstrations=shown, initial_stiffness=7.0).policy()
    x = demos[0].x[::20]
    assert policy.stiffness_dim == 2
    torch.testing.assert_close(policy.stiffness(x).detach(), rising[0][::20], rtol=0.02, atol=1.0)
    with pytest.raises(InvalidArgumentError, match=r"has to have 1 column\(s\) for this task, got 2"):
        tasks.make("divergent_field", demonstrations=shown, stiffness="isotropic").policy()


@pytest.mark.slow
def test_a_task_without_use_for_stiffness_says_so():
    demos = tasks.make("via_point").demonstrations.with_stiffness(100.0)
    with pytest.warns(DemonstrationWarning, match=r"1 variable\(s\) .* left out: this task learns no stiffness"):
        assert tasks.make("via_point", demonstrations=demos).policy().stiffness_dim == 0


def test_a_mixture_without_stiffness_gets_the_constant(random_mixture):
    plain = random_mixture(F=4)
    policy = with_stiffness(plain, 2, 2, 2, 30.0)
    stiffness = policy.stiffness(torch.zeros(5, 2, dtype=torch.float64)).detach()
    torch.testing.assert_close(stiffness, torch.full_like(stiffness, 30.0))
    torch.testing.assert_close(without_stiffness(plain, 2, 2, "").pack(), GMRPolicy.from_mixture(plain, 2).pack())


def test_a_motion_that_has_no_stiffness_gets_a_constant_one_and_stays_as_it_was(random_policy):
    motion, x = random_policy(), torch.randn(7, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    policy = with_constant_stiffness(motion, 2, 30.0)
    torch.testing.assert_close(policy(x), motion(x), rtol=1e-12, atol=1e-12)
    assert (policy.stiffness(x) - 30.0).abs().max() < 1e-12 and policy.stiffness_dim == 2
