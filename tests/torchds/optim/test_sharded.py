"""Roll-outs shared out over real processes: the step of one process, bit for bit, and what goes wrong in one of them."""

import datetime
import importlib
import os
import time

import pytest
import torch
import torch.distributed as dist

import torchds
from tests.forked import forked
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, TrajectorySpace
from torchds.optim import PI2, PI2CMA, PIBB, SurrogatePIBB, sharded

MEANS = torch.tensor([[1.0, 1.0], [0.6, 0.2], [0.1, 0.0]], dtype=torch.float64)
SLOPES = [[[-0.5, 0.3], [-0.4, -0.6]], [[-0.8, -0.2], [0.1, -0.5]], [[-0.7, 0.0], [0.2, -0.9]]]
X0, END = MEANS[0], MEANS.new_tensor([0.5, 0.5])
BACKENDS = {"fused": "auto", "eager": "eager"}


def started():
    covariances = 0.1 * torch.eye(2, dtype=torch.float64).expand(3, 2, 2)
    slopes = torch.tensor(SLOPES, dtype=torch.float64)
    return torchds.GMRPolicy(torch.ones(3, dtype=torch.float64) / 3, MEANS, covariances, slopes, 0.1 * MEANS)


def along(policy):
    return TrajectorySpace.relative(policy, X0, 30, 0.2)


def learned(cls, n, runs, backend, exploration=None, **options):
    policy = started().expand(*runs)
    noise = Gaussian(0.01) if exploration is None else exploration(policy)
    generator = torch.Generator().manual_seed(3)
    optim = cls(policy.parameters(), noise, n, control_weight=1e-3, generator=generator, **options)

    def closure():
        path = torchds.rollout(policy, X0, 30, 0.2, backend=BACKENDS[backend])
        if cls is PI2:
            return (path.x[..., 1:, :] - END).square().sum(-1) / 30
        return (path.x[..., 1:, :] - END).square().sum((-1, -2)) / 30

    for _ in range(4):
        optim.step(sharded(closure))
    return {"theta": policy.pack().detach(), "cost": optim.last.cost, "draws": generator.get_state()}


def all_learned():
    found = {}
    for backend in BACKENDS:
        found[f"PIBB {backend}"] = learned(PIBB, 5, (2,), backend)
        found[f"PI2 {backend}"] = learned(PI2, 5, (), backend)
    found["fewer roll-outs than processes"] = learned(PIBB, 1, (), "fused")
    found["one by one"] = learned(PIBB, 5, (), "fused", batched=False)
    found["surrogate"] = learned(SurrogatePIBB, 7, (2,), "fused", along)
    found["PI2CMA"] = learned(PI2CMA, 7, (2,), "fused")
    return found


def in_vain(rank, seed, divisor):
    """An update that has to fail; returns why."""
    theta = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
    optim = PIBB([theta], Gaussian(0.1), 4, generator=torch.Generator().manual_seed(seed))
    with pytest.raises(Exception) as caught:
        optim.step(sharded(lambda: theta.sum(-1) * (1 / divisor)))
    assert not theta.any()
    return f"{caught.type.__name__}: {caught.value}"


@pytest.mark.slow
def test_two_processes_make_the_steps_of_one(tmp_path):
    alone = all_learned()

    def work(rank):
        dist.init_process_group("gloo")
        torch.save(all_learned(), tmp_path / f"{rank}.pt")
        dist.destroy_process_group()

    for code, said in forked(2, work):
        assert code == 0, said
    for rank in range(2):
        one = torch.load(tmp_path / f"{rank}.pt", weights_only=True)
        assert set(one) == set(alone)
        for name, values in alone.items():
            for what, value in values.items():
                assert torch.equal(one[name][what], value), (name, what)


def test_what_goes_wrong_in_one_process_is_said_in_all():
    def work(rank):
        dist.init_process_group("gloo")
        raised = in_vain(rank, 0, rank - 1)
        words = ("closure raised in process 1: ZeroDivisionError", "ZeroDivisionError: division by zero")[rank]
        assert words in raised, raised
        assert "do not try the same policies" in in_vain(rank, rank, 1)
        if rank == 0:  # the other has gone
            assert "ProcessLostError: process 0 of 2 has lost another one" in in_vain(rank, 0, 1)
        dist.destroy_process_group()

    for code, said in forked(2, work):
        assert code == 0, said


def test_a_process_that_hangs_is_not_waited_for_longer_than_was_said():
    importlib.import_module("torch._dynamo")  # which the first optimizer does, for seconds

    def work(rank):
        dist.init_process_group("gloo", timeout=datetime.timedelta(seconds=60))
        dist.barrier()  # they have met, which may take its time
        dist.distributed_c10d._set_pg_timeout(datetime.timedelta(seconds=0.5), dist.group.WORLD)
        if rank == 0:
            began = time.monotonic()
            assert "ProcessLostError" in in_vain(rank, 0, 1) and time.monotonic() - began < 2.5
        else:
            time.sleep(3.0)
        os._exit(0)

    for code, said in forked(2, work):
        assert code == 0, said


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
