"""The checks pass what the library has, and refuse what breaks a promise."""

import pytest
import torch

from torchds import Bounds, costs, rollout, testing
from torchds.exploration import Exploration, Gaussian, Homogeneous
from torchds.impedance import ImpedanceControlled
from torchds.optim import PI2CMA, PIBB, SurrogatePIBB
from torchds.plants import PointMass


def test_the_librarys_own_objects_pass(random_policy, randn):
    policy = random_policy()
    testing.check_policy(policy, randn(3, 2))
    testing.check_exploration(Homogeneous(policy, 0.1), list(policy.parameters()))
    testing.check_exploration(Gaussian(0.1), list(policy.parameters()))
    testing.check_stop(Bounds(-1.0, 1.0), randn(6, 2))
    testing.check_plant(ImpedanceControlled(PointMass(), stiffness=20.0), randn(3, 2))
    path = rollout(random_policy(batch=(3,)), randn(2), 10, 0.1)
    testing.check_cost(lambda path: costs.goal(path.x, torch.zeros(2).double()), path)


@pytest.mark.parametrize("kind", [PIBB, PI2CMA, SurrogatePIBB])
def test_the_librarys_own_optimizers_pass(kind):
    testing.check_optimizer(lambda params: kind(params, Gaussian(0.3), n_rollouts=10))


class Coupled(Exploration):
    def __call__(self, parameters, normals):
        return [z - z.mean(0) for z in normals]


class Biased(Exploration):
    def __call__(self, parameters, normals):
        return [z + 0.1 for z in normals]


class Meddling(Exploration):
    @torch.no_grad()
    def __call__(self, parameters, normals):
        for p in parameters:
            p.mul_(1.1)
        return list(normals)


class Forgetful(PIBB):
    def state_dict(self):
        return {**super().state_dict(), "generator": torch.Generator().manual_seed(1).get_state()}


@pytest.mark.parametrize(
    "exploration, sentence",
    [(Coupled(), "depend on the others"), (Biased(), "zero normals"), (Meddling(), "must not change")],
)
def test_broken_explorations_are_refused(exploration, sentence, random_policy):
    with pytest.raises(AssertionError, match=sentence):
        testing.check_exploration(exploration, list(random_policy().parameters()))


def test_other_broken_objects_are_refused(random_policy, randn):
    with pytest.raises(AssertionError, match="bit for bit"):
        testing.check_optimizer(lambda params: Forgetful(params, Gaussian(0.3)))
    with pytest.raises(AssertionError, match="NaN must not be taken"):
        testing.check_stop(lambda x, x_next: x_next[..., 0] > 0, randn(6, 2))
    with pytest.raises(AssertionError, match="one per point"):
        testing.check_stop(lambda x, x_next: (x_next > 0).all(), randn(6, 2))
    path = rollout(random_policy(batch=(3,)), randn(2), 10, 0.1)
    with pytest.raises(AssertionError, match="depend on the others"):
        testing.check_cost(lambda path: path.x.sum((-1, -2)) - path.x.mean(), path)
    with pytest.raises(AssertionError, match="as many costs"):
        testing.check_cost(lambda path: path.x.sum(), path)
