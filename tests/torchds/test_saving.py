"""A policy in a file: what comes back is the same policy, of any batch, with what belongs to it."""

import copy

import pytest
import torch

import torchds
from torchds import files
from torchds.errors import FileError


def same(policy, other):
    assert type(other) is torchds.GMRPolicy and other.batch_shape == policy.batch_shape
    state, mine = other.state_dict(), policy.state_dict()
    return list(state) == list(mine) and all(
        torch.equal(state[name], value) and state[name].dtype == value.dtype for name, value in mine.items()
    )


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
@pytest.mark.parametrize("size", [{}, {"O": 3}, {"Q": 2}, {"K": 1, "D": 1, "O": 1}])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_policy_comes_back_bit_for_bit(random_policy, tmp_path, batch, size, dtype):
    policy = random_policy(**size, batch=batch, moved=True).to(dtype)
    policy.save(tmp_path / "policy.pt")
    assert same(policy, torchds.load_policy(tmp_path / "policy.pt"))
    assert torch.load(tmp_path / "policy.pt", weights_only=True)["kind"] == "policy"


def test_policies_of_several_gatings_come_back(random_mixture, tmp_path):
    policy = torchds.GMRPolicy.from_mixture(random_mixture(batch=(4,)), 2)
    policy.save(tmp_path / "policy.pt", goal=torch.arange(8.0).reshape(4, 2))
    again = torchds.load_policy(tmp_path / "policy.pt")
    assert same(policy, again) and same(policy[1], again[1]) and again[1].info.goal.tolist() == [2.0, 3.0]


def test_what_belongs_to_it_comes_back_and_is_kept(random_policy, tmp_path):
    policy = random_policy()
    policy.save(tmp_path / "a.pt", goal=torch.ones(2), P=2 * torch.eye(2), names=("x", "y"), units="m", dt=0.01)
    again = torchds.load_policy(tmp_path / "a.pt")
    again.save(tmp_path / "b.pt", units="mm")
    info = torchds.load_policy(tmp_path / "b.pt").info
    assert torch.equal(info.goal, torch.ones(2)) and torch.equal(info.P, 2 * torch.eye(2))
    assert info[2:5] == (("x", "y"), "mm", 0.01) and info.versions["torch"] == torch.__version__
    assert info.versions["torchds"] == torchds.__version__  # also where what is installed is older
    assert policy.info.goal is None and copy.deepcopy(again).info.units == "m"


def test_a_certificate_survives(tmp_path):
    generator = torch.Generator().manual_seed(1)
    raw = torch.randn(2, 3, 2, 2, generator=generator, dtype=torch.float64)
    goal = torch.tensor([0.3, -0.2], dtype=torch.float64)
    A = -raw[0] @ raw[0].mT - torch.eye(2, dtype=torch.float64)
    b = -(A @ goal.unsqueeze(-1)).squeeze(-1)
    eye = torch.eye(2, dtype=torch.float64).repeat(3, 1, 1)
    fit = torchds.StableFit(
        torchds.GMRPolicy(torch.ones(3) / 3, raw[1, :, 0], eye, A, b), goal, eye[0], torch.tensor(0.0), torch.tensor(3)
    )
    fit.save(tmp_path / "fit.pt", dt=0.1)
    again = torchds.load_policy(tmp_path / "fit.pt")
    mine, its = fit.certificate(), again.certificate(again.info.goal, again.info.P)
    assert bool(its.stable) and torch.equal(mine.margin, its.margin) and torch.equal(mine.eigenvalues, its.eigenvalues)


def test_a_constrained_policy_is_saved_by_its_values(tmp_path):
    eye = torch.eye(2, dtype=torch.float64)[None]
    policy = torchds.GMRPolicy(torch.ones(1), eye[:, 0], eye, -eye, torch.zeros(1, 2))
    torchds.stability.constrain(policy, goal=torch.zeros(2), margin=0.1)
    policy.save(tmp_path / "policy.pt")
    assert torch.equal(torchds.load_policy(tmp_path / "policy.pt").A, policy.A)


def test_a_file_that_holds_something_else_is_refused(random_policy, tmp_path):
    path = tmp_path / "policy.pt"
    random_policy().save(path)
    content = files.load(path, "policy")
    for change in ({"values": {}}, {"values": {**content["values"], "A": 3}}):
        files.save(path, "policy", content | change)
        with pytest.raises(FileError, match=r"policy.pt holds no policy of this version"):
            torchds.load_policy(path)
    with pytest.raises(FileError, match=r"no such file \(looked in"):
        torchds.load_policy(tmp_path / "none.pt")
