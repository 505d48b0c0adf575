"""Objects that move: all tensors that they hold, and what they compute afterwards."""

from typing import NamedTuple

import pytest
import torch
from torch.testing import assert_close

import torchds
from tests.far import FAR, pretended
from torchds import Bounds, Demonstrations, GMRPolicy, Walls
from torchds.devices import Movable, moved
from torchds.forces import ConstantForce, DivergentForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass


class Pair(NamedTuple):
    x: torch.Tensor
    n: int


class Holder(Movable):
    def __init__(self):
        self.parts = {"a": [torch.ones(2)], "b": (torch.arange(2), "text")}


def test_containers_keep_their_kind_and_whole_numbers_their_dtype():
    pair, (first, *rest) = moved((Pair(torch.ones(1), 3), [torch.zeros(2), torch.tensor([True])]), dtype=torch.float64)
    assert isinstance(pair, Pair) and pair.x.dtype == torch.float64 and pair.n == 3
    assert first.dtype == torch.float64 and rest[0].dtype == torch.bool
    holder = Holder()
    there = holder.to(dtype=torch.float16)
    assert there.parts["a"][0].dtype == torch.float16 and there.parts["b"][0].dtype == torch.int64
    assert holder.parts["a"][0].dtype == torch.float32  # a copy


def steps(device, dtype=torch.float64):
    """Roll-outs of one policy with every stop condition, force and plant of the library, all moved."""
    x = torch.linspace(0, 1, 30, dtype=torch.float64)[:, None]
    demos = Demonstrations([torch.cat([x - 1, x * (1 - x)], -1)], dt=0.1).to(device, dtype)
    mixture = torchds.GaussianMixture.fit(demos, 2, n_init=1, tol=1e-3).to(device, dtype)
    policy, x0 = GMRPolicy.from_mixture(mixture, 2), demos[0].x[0]
    square = torch.tensor([[[-0.9, -1.0], [-0.9, 1.0]]], dtype=torch.float64)
    line = torch.stack([x[:, 0] - 1, 0 * x[:, 0]], -1)
    forces = [ConstantForce(torch.tensor([0.0, 1.0]), border=-0.9), DivergentForce(line, 2.0, along_normal=True)]
    plants = [ImpedanceControlled(PointMass(force=force), torch.tensor([10.0, 5.0])) for force in forces]
    stops = [Bounds(torch.tensor([-2.0, -2.0]), 2.0), Walls(square), None]
    for stop, plant in zip(stops, [None, *plants], strict=True):
        path = torchds.rollout(
            policy, x0, 6, 0.2, stop=moved(stop, device, dtype), plant=moved(plant, device, dtype), backend="eager"
        )
        yield path.to("cpu", torch.float64)


@pytest.mark.slow
def test_everything_meets_on_a_device_that_is_not_there():
    here = list(steps("cpu"))
    with pretended():
        there = list(steps(FAR))
    for ours, theirs in zip(here, there, strict=True):
        assert_close(theirs.x.detach(), ours.x.detach(), rtol=1e-12, atol=1e-12)
    assert here[1].stopped and not here[0].stopped


def test_everything_meets_in_single_precision():
    for ours, theirs in zip(steps("cpu"), steps("cpu", torch.float32), strict=True):
        assert_close(theirs.x.detach(), ours.x.detach(), rtol=1e-3, atol=1e-3)


def test_demonstrations_and_mixtures_move_with_what_belongs_to_them(random_mixture):
    demos = torchds.load_lasa("Angle", 2).every(50).to(dtype=torch.float32)
    assert demos.names == torchds.load_lasa("Angle", 1).names
    assert {demo.v.dtype for demo in demos} == {torch.float32}
    mixture = random_mixture()
    single = mixture.to(dtype=torch.float32)
    y = torch.zeros(2, 4, dtype=torch.float64)
    assert_close(single.log_prob(y.float()), mixture.log_prob(y).float(), rtol=1e-5, atol=1e-5)
    with pretended():
        assert mixture.to(FAR).log_prob(y.to(FAR)).device == FAR


def test_what_is_left_behind_is_noticed(random_policy, randn):
    """The device that is not there refuses what a GPU would refuse."""
    policy, x = random_policy(), randn(5, 2)
    with pretended():
        there = policy.to(FAR)
        with pytest.raises(RuntimeError, match="tensors on two devices"):
            there(x.to(FAR)) + x
