"""Roll-outs shared out over real processes: the step of one process, bit for bit, and what goes wrong in one of them."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

import torchds
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB, sharded

ROOT = Path(__file__).parents[3]

WORKER = """
import sys, torch, torchds
import torch.distributed as dist
from torchds.exploration import Gaussian, TrajectorySpace
from torchds.optim import PI2, PI2CMA, PIBB, SurrogatePIBB, sharded

rank, size, folder = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
torch.set_num_threads(1)
if size:
    dist.init_process_group("gloo", init_method=f"file://{folder}/store", rank=rank, world_size=size)

means = torch.tensor([[1.0, 1.0], [0.6, 0.2], [0.1, 0.0]], dtype=torch.float64)
A = torch.tensor([[[-0.5, 0.3], [-0.4, -0.6]], [[-0.8, -0.2], [0.1, -0.5]], [[-0.7, 0.0], [0.2, -0.9]]]).double()
start = torchds.GMRPolicy(torch.ones(3).double() / 3, means, 0.1 * torch.eye(2).double().expand(3, 2, 2), A, 0.1 * means)
x0, end = means[0], means.new_tensor([0.5, 0.5])
BACKENDS = {"fused": "auto", "eager": "eager"}


def learned(cls, n, runs, backend, exploration=None, **options):
    policy = start.expand(*runs)
    noise = Gaussian(0.01) if exploration is None else exploration(policy)
    generator = torch.Generator().manual_seed(3)
    optim = cls(policy.parameters(), noise, n, control_weight=1e-3, generator=generator, **options)

    def closure():
        path = torchds.rollout(policy, x0, 30, 0.2, backend=BACKENDS[backend])
        if cls is PI2:
            return (path.x[..., 1:, :] - end).square().sum(-1) / 30
        return (path.x[..., 1:, :] - end).square().sum((-1, -2)) / 30

    for _ in range(4):
        optim.step(sharded(closure))
    return {"theta": policy.pack().detach(), "cost": optim.last.cost, "draws": generator.get_state()}


along = lambda policy: TrajectorySpace.relative(policy, x0, 30, 0.2)
found = {}
for backend in BACKENDS:
    found[f"PIBB {backend}"] = learned(PIBB, 5, (2,), backend)
    found[f"PI2 {backend}"] = learned(PI2, 5, (), backend)
found["fewer roll-outs than processes"] = learned(PIBB, 1, (), "fused")
found["one by one"] = learned(PIBB, 5, (), "fused", batched=False)
found["surrogate"] = learned(SurrogatePIBB, 7, (2,), "fused", along)
found["PI2CMA"] = learned(PI2CMA, 7, (2,), "fused")
torch.save(found, f"{folder}/{size}-{rank}.pt")

if size:
    theta = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
    cases = (0, rank - 1, "closure raised in process 1: ZeroDivisionError"), (rank, 1, "do not try the same policies")
    for seed, divisor, words in cases:
        optim = PIBB([theta], Gaussian(0.1), 4, generator=torch.Generator().manual_seed(seed))
        try:
            optim.step(sharded(lambda: theta.sum(-1) * (1 / divisor)))
        except ZeroDivisionError:
            assert rank == 1 and divisor == 0
        except Exception as error:
            assert words in str(error), error
        else:
            raise AssertionError(words)
        assert not theta.any()
    dist.destroy_process_group()
"""


def together(size, folder):
    """What `size` processes learned, of each; 0 for one that knows of no others."""
    command = [sys.executable, "-c", WORKER]
    started = [
        subprocess.Popen([*command, str(rank), str(size), str(folder)], cwd=ROOT, stderr=subprocess.PIPE, text=True)
        for rank in range(max(size, 1))
    ]
    for process in started:
        _, said = process.communicate(timeout=120)
        assert process.returncode == 0, said
    (folder / "store").unlink(missing_ok=True)
    return [torch.load(folder / f"{size}-{rank}.pt", weights_only=True) for rank in range(max(size, 1))]


@pytest.mark.slow
def test_two_processes_make_the_steps_of_one(tmp_path):
    (alone,) = together(0, tmp_path)
    for one in together(2, tmp_path):
        assert set(one) == set(alone)
        for name, values in alone.items():
            for what, value in values.items():
                assert torch.equal(one[name][what], value), (name, what)


def test_one_process_is_the_closure_itself():
    theta = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
    ends = []
    for wrap in (sharded, lambda closure: closure):
        with torch.no_grad():
            theta.zero_()
        optim = PIBB([theta], Gaussian(0.3), generator=torch.Generator().manual_seed(0))
        optim.step(wrap(lambda: (theta - 1.0).square().sum(-1)))
        ends.append(theta.detach().clone())
    assert torch.equal(*ends) and ends[0].any()
    assert torch.equal(sharded(lambda: theta.sum())(), theta.sum())


def test_what_is_no_closure_is_refused():
    with pytest.raises(InvalidArgumentError, match="sharded needs a closure"):
        torchds.optim.sharded(3)
