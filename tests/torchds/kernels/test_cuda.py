"""What a GPU makes of a roll-out: what it refuses, and that Triton compiles it."""

import re

import pytest
import torch

import torchds
from tests.torchds.kernels.comparison import needs_numba
from tests.torchds.kernels.interpreted import loaded
from tests.torchds.kernels.test_cpu import FORCES
from tests.torchds.kernels.test_fused import WALLS
from tests.torchds.kernels.test_steps import Circle, Lag, Wind
from torchds import Bounds, disturbances, rollout
from torchds.forces import ConstantForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

pytestmark = [needs_numba, pytest.mark.slow]


@torch.no_grad()
def test_steps_in_python_are_for_the_cpu(random_policy, randn):
    policy, x0 = random_policy(2, 2, 2, 1), randn(2)
    windy = ImpedanceControlled(PointMass(force=Wind(2.0)), low=0.1)
    with loaded(interpreted=True):
        for options in ({"stop": Circle()}, {"plant": Lag()}, {"plant": windy}):
            with pytest.raises(torchds.errors.InvalidArgumentError, match="a scalar step in Python is for the CPU"):
                rollout(policy, x0, 3, 0.1, **options, backend="fused")
            eager, auto = (rollout(policy, x0, 3, 0.1, **options, backend=backend) for backend in ("eager", "auto"))
            assert torch.equal(eager.x, auto.x)


@torch.no_grad()
def test_large_policies_are_eager(random_policy, randn):
    policy, x0 = random_policy(42, 3, 3), randn(3)
    with loaded(interpreted=True):
        with pytest.raises(
            torchds.errors.InvalidArgumentError, match=r"too long a kernel, .* is 1008 and at most 1000"
        ):
            rollout(policy, x0, 2, 0.1, backend="fused")
        assert torch.equal(rollout(policy, x0, 2, 0.1).x, rollout(policy, x0, 2, 0.1, backend="eager").x)


class Hopper:
    """The GPU that Triton is told it compiles for; nothing is started there."""

    def get_current_target(self):
        from triton.backends.compiler import GPUTarget

        return GPUTarget("cuda", 90, 32)

    def get_current_device(self):
        return 0

    def get_current_stream(self, device):
        return 0


@pytest.fixture
def compiled(monkeypatch, tmp_path):
    """What Triton compiles for that GPU, in the order of the calls."""
    import triton

    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(triton.runtime.driver, "_active", Hopper())
    with loaded(interpreted=False) as cuda:
        kernels, run = [], cuda.roll.run
        monkeypatch.setattr(cuda.roll, "run", lambda *a, warmup, **k: kernels.append(run(*a, warmup=True, **k)))
        yield kernels


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@torch.no_grad()
def test_it_compiles_for_a_gpu_once_for_all_numbers_of_rollouts(random_policy, randn, dtype, compiled):
    plant = ImpedanceControlled(PointMass(force=ConstantForce(randn(2))), low=0.1)
    for batch, points in (((), ()), ((16,), ()), ((5,), (3,))):
        policy, x0 = random_policy(2, 2, 2, 1, batch=batch).to(dtype), randn(*points, 2).to(dtype)
        rollout(policy, x0, 7, 0.1, stop=Bounds(-1.0, 1.0), plant=plant, backend="fused")
    assert len({id(kernel) for kernel in compiled}) == 1 and len(compiled) == 3
    kernel = compiled[0]
    assert kernel.asm["cubin"] and kernel.metadata.num_warps == 1
    assert kernel.metadata.shared == 0  # what is read as a block and taken apart never leaves the registers
    if dtype == torch.float32:  # in float64 the exponential has products of its own that are fused
        assert not re.search(r"fma\.|(add|sub|mul|div)\.\S*f64", kernel.asm["ptx"])


@pytest.mark.parametrize("name", ["half-plane", "radial", "normal"])
@torch.no_grad()
def test_it_compiles_all_steps_that_it_knows(random_policy, randn, name, compiled):
    """The interpreter takes more of Python than the compiler does."""
    chance = disturbances.draw((2,), 7, 0.1, sensor=0.1, push=2.0, generator=torch.Generator().manual_seed(0))
    plant = ImpedanceControlled(PointMass(1.3, 0.7, FORCES[name]), low=0.1, disturbance=chance)
    rollout(random_policy(2, 2, 2, 1), randn(2, 2), 7, 0.1, stop=WALLS, plant=plant, backend="fused")
    assert compiled[0].asm["cubin"]
