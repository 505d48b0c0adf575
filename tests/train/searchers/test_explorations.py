"""Explorations by name, with the sizes that the options or the task give them."""

import pytest
import torch

from tasks import SearchSettings
from tests.motions import Short
from torchds import Demonstrations, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous, TrajectorySpace
from torchds.exploration.primitive import Along
from train.options import options_for
from train.searchers.explorations import along_motion, make_exploration


@pytest.fixture(scope="module")
def task():
    return Short()


@pytest.mark.parametrize(
    ("name", "kind"), [("homogeneous", Homogeneous), ("gaussian", Gaussian), ("trajectory", TrajectorySpace)]
)
@pytest.mark.slow
def test_every_name_is_one_exploration(task, name, kind):
    options = options_for("via_point", exploration=name)
    assert isinstance(make_exploration(options, task, task.policy()), kind)
    assert along_motion(options) == (kind is TrajectorySpace)


def test_the_size_of_homogeneous_noise_is_the_one_given(task):
    policy = task.policy()
    one, two = (make_exploration(options_for("via_point", noise=size), task, policy).std() for size in (0.1, 0.2))
    for name in one:
        torch.testing.assert_close(two[name], 2 * one[name])


@pytest.mark.slow
def test_stiffness_or_motion_alone_is_perturbed_where_that_is_asked():
    from tasks import make

    task = make("divergent_field")
    policy = task.policy()
    for learn, still in (("motion", "stiffness_A"), ("stiffness", "A")):
        std = make_exploration(options_for("divergent_field", learn=learn), task, policy).std()
        assert [name for name in ("A", "stiffness_A") if not std[name].any()] == [still]
    with pytest.raises(InvalidArgumentError, match="--learn motion goes with --exploration homogeneous"):
        make_exploration(options_for("divergent_field", learn="motion", exploration="trajectory"), task, policy)


class Unsized(Short):
    """A letter that gives no sizes of noise."""

    search = SearchSettings()


class Tenfold(Unsized):
    """The same, a tenth as large: in other units."""

    def default_demonstrations(self):
        own = super().default_demonstrations()
        return Demonstrations([d.x / 10 for d in own], [d.v / 10 for d in own], own.dt)

    def motion(self):
        motion = super().motion()
        return motion._replace(x0=motion.x0 / 10)


@pytest.mark.parametrize("name", ["homogeneous", "gaussian", "stable"])
@pytest.mark.slow
def test_noise_of_a_task_without_sizes_is_a_share_of_its_motion_in_any_unit(name):
    """The same normals make velocities twelve per cent as fast as the motion, whatever it is measured in."""
    shares = []
    for task in (Unsized(), Tenfold()):
        policy, motion = task.policy(), task.motion()
        exploration = make_exploration(options_for("via_point", exploration=name), task, policy)
        exploration = exploration.raw if name == "stable" else exploration  # the goal is the origin
        generator = torch.Generator().manual_seed(0)
        parameters = list(policy.parameters())
        A, b = exploration(parameters, [torch.randn(500, *p.shape, generator=generator).to(p) for p in parameters])
        path = rollout(policy, *motion)
        x = path.inputs.detach()
        h = policy.gating(x).detach()
        noise = torch.einsum("tk,nkod,td->nto", h, A, x) + torch.einsum("tk,nko->nto", h, b)
        shares.append(float(noise.norm(dim=-1).mean() / path.v.detach().norm(dim=-1).mean()))
    assert shares[0] == pytest.approx(shares[1], rel=0.02)
    assert 0.04 < shares[0] < 0.2


def test_a_primitive_has_noise_of_its_own_and_no_stable_one():
    task = Short(system="dmp")
    kinds = {"homogeneous": Gaussian, "gaussian": Gaussian, "trajectory": Along}
    for name, kind in kinds.items():
        made = make_exploration(options_for("via_point", system="dmp", exploration=name), task, task.policy())
        assert isinstance(made, kind)
    with pytest.raises(
        InvalidArgumentError, match="stable needs a dynamical system; for a primitive use homogeneous or"
    ):
        make_exploration(options_for("via_point", system="dmp", exploration="stable"), task, task.policy())
