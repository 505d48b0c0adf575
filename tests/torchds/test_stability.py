import copy

import numpy as np
import pytest
import scipy.linalg
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn.utils import parametrize
from torch.testing import assert_close

import torchds
from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB
from torchds.stability import (
    certificate,
    constrain,
    largest_eigenvalue,
    project,
    stable_factors,
    stable_matrices,
)


@st.composite
def cases(draw):
    """(normals, K, D): normals from a seed, as many components and dimensions as the paper's tasks and more."""
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    scale = draw(st.sampled_from([1e-3, 1.0, 30.0]))
    return (
        lambda *shape: scale * torch.randn(*shape, generator=generator, dtype=torch.float64),
        draw(st.integers(1, 10)),
        draw(st.integers(2, 7)),
    )


def metric(normals, D, batch=()):
    """A random P ≻ 0 with a condition number of at most some hundreds."""
    root = normals(*batch, D, D)
    return root @ root.mT / root.square().mean() + 0.1 * torch.eye(D, dtype=torch.float64)


def policy_of(A, goal, means=None):
    """A policy of these slopes, tied to the goal, with unit Gaussians."""
    K, D = A.shape[-3], A.shape[-1]
    means = torch.zeros(K, D, dtype=torch.float64) if means is None else means
    gate = torch.full((K,), 1 / K, dtype=torch.float64), means, torch.eye(D, dtype=torch.float64).repeat(K, 1, 1)
    return GMRPolicy(*gate, A, -(A @ goal[..., None, :, None]).squeeze(-1))


# ---------------------------------------------------------------------- the set


@settings(max_examples=200, deadline=None)
@given(cases(), st.floats(1e-3, 2.0), st.booleans())
@pytest.mark.slow
def test_any_tensors_give_slopes_in_the_set(case, margin, weighted):
    normals, K, D = case
    P = metric(normals, D) if weighted else torch.eye(D, dtype=torch.float64)
    A = stable_matrices(normals(3, K, D, D), normals(3, K, D, D), P if weighted else None, margin=margin)
    condition = P @ A + A.mT @ P + 2 * margin * P  # ⪯ 0 up to round-off
    tolerance = 1e-12 * (P @ A).abs().amax((-2, -1)) + 1e-12
    assert (torch.linalg.eigvalsh(condition)[..., -1] <= tolerance).all()


@settings(max_examples=100, deadline=None)
@given(cases(), st.floats(1e-3, 2.0))
@pytest.mark.slow
def test_projection_leaves_slopes_in_the_set_alone_and_moves_others_onto_its_boundary(case, margin):
    normals, K, D = case
    P, A = metric(normals, D), normals(K, D, D)
    inside = stable_matrices(normals(K, D, D), normals(K, D, D), P, margin=1.01 * margin)
    assert torch.equal(project(inside, P, margin=margin), inside)
    moved, rates = project(A, P, margin=margin), largest_eigenvalue(A, P)
    tolerance = 1e-9 * (1 + A.abs().max())
    assert (largest_eigenvalue(moved, P) <= -margin + tolerance).all()
    outside = rates > -margin
    assert_close(largest_eigenvalue(moved, P)[outside], rates[outside] * 0 - margin, rtol=0, atol=float(tolerance))
    assert torch.equal(moved[~outside], A[~outside])


def test_no_slopes_of_the_set_are_nearer_than_the_projection(randn):
    """A projection on a convex set: the way to it makes no acute angle with the way on to any member."""
    D, margin = 3, 0.2
    P = metric(randn, D)
    C = torch.linalg.cholesky(P).mT
    A = randn(20, D, D)
    nearest = project(A, P, margin=margin)
    member = stable_matrices(randn(500, 1, D, D), randn(500, 1, D, D), P, margin=margin)
    away, onward = (C @ M @ torch.linalg.inv(C) for M in (A - nearest, member - nearest))
    assert ((away * onward).sum((-2, -1)) <= 1e-10).all()


@settings(max_examples=100, deadline=None)
@given(cases(), st.floats(1e-3, 2.0))
@pytest.mark.slow
def test_factors_are_the_inverse_of_the_parametrisation(case, margin):
    normals, K, D = case
    P = metric(normals, D)
    A = project(normals(K, D, D), P, margin=1.1 * margin)
    scale = float(A.abs().max())
    assert_close(
        stable_matrices(*stable_factors(A, P, margin=margin), P, margin=margin), A, rtol=1e-8, atol=1e-9 * scale
    )


def test_slopes_outside_have_no_factors(randn):
    A = torch.stack([-torch.eye(2), torch.eye(2)]).double()
    with pytest.raises(
        InvalidArgumentError, match=r"converge with a rate above 0.1, got 1 of 2 that do not; .* project"
    ):
        stable_factors(A, margin=0.1)


@settings(max_examples=50, deadline=None)
@given(cases())
@pytest.mark.slow
def test_the_largest_eigenvalue_is_that_of_the_generalised_problem(case):
    normals, K, D = case
    P, A = metric(normals, D), normals(K, D, D)
    expected = [scipy.linalg.eigh(((P @ a + a.T @ P) / 2).numpy(), P.numpy(), eigvals_only=True)[-1] for a in A]
    assert_close(largest_eigenvalue(A, P).numpy(), np.array(expected), rtol=1e-9, atol=1e-9 * float(A.abs().max()))
    assert_close(largest_eigenvalue(A).numpy(), np.linalg.eigvalsh((A + A.mT).numpy() / 2)[..., -1])


def test_the_eigenvalue_differentiates(randn):
    torch.autograd.gradcheck(largest_eigenvalue, (randn(4, 3, 3).requires_grad_(), metric(randn, 3)))


# ---------------------------------------------------------------------- what the set is for


@pytest.mark.slow
@pytest.mark.parametrize("weighted", [False, True])
def test_the_lyapunov_function_falls_along_every_motion_and_as_fast_as_the_margin_says(randn, weighted):
    D, K, margin, dt = 3, 5, 0.5, 1e-3
    P, goal = metric(randn, D) if weighted else None, randn(D)
    A = stable_matrices(randn(8, K, D, D), randn(8, K, D, D), P, margin=margin)
    policy = policy_of(A, goal, means=randn(K, D))
    proof = policy.certificate(goal, P)
    assert proof.stable.all()
    assert (proof.margin >= margin - 1e-12).all()
    x = rollout(policy, goal + randn(10, D), n_steps=4000, dt=dt).x.detach() - goal
    V = (x @ (torch.eye(D).double() if P is None else P) * x).sum(-1)
    assert (V.diff(dim=-1) < 0).all()
    bound = V[..., :1] * torch.exp(-2 * margin * dt * torch.arange(4001))
    assert (V / bound <= 1.05).all()  # Euler's method errs by dt |A|² t


def test_a_certificate_names_the_rate_and_the_component_that_fails(randn):
    A = torch.stack([-torch.eye(2), torch.tensor([[-1.0, 3.0], [0.0, -1.0]])]).double()
    policy, goal = policy_of(A, torch.tensor([3.0, -2.0]).double()), torch.tensor([3.0, -2.0]).double()
    proof = policy.certificate(goal)
    assert_close(proof.eigenvalues, torch.tensor([-1.0, 0.5]).double())
    assert proof.offset.tolist() == [0.0, 0.0]
    assert not proof.stable
    assert float(proof.margin) == pytest.approx(-0.5)
    proof = policy.certificate(goal, torch.diag(torch.tensor([1.0, 9.0])))  # in float32, as a user may give it
    assert_close(proof.eigenvalues, torch.tensor([-1.0, -0.5]).double())
    assert proof.stable


def test_offsets_that_are_not_tied_to_the_goal_fail(randn):
    goal = randn(2)
    policy = policy_of(stable_matrices(randn(3, 2, 2), randn(3, 2, 2), margin=0.1), goal)
    assert policy.certificate(goal).stable
    with torch.no_grad():
        policy.b[1] += torch.tensor([0.3, 0.4], dtype=torch.float64)
    proof = policy.certificate(goal)
    assert_close(proof.offset, torch.tensor([0.0, 0.5, 0.0]).double(), rtol=0, atol=1e-12)
    assert not proof.stable
    assert not policy.certificate(goal + 1e-6).stable


def test_a_batch_of_certificates_equals_single_ones(randn):
    goal, P = randn(4, 3), metric(randn, 3, batch=(4,))
    A = stable_matrices(randn(4, 5, 3, 3), randn(4, 5, 3, 3), P.unsqueeze(1), margin=0.1)
    A[2] = randn(5, 3, 3)
    policy = policy_of(A, goal)
    together = certificate(policy, goal, P)
    assert together.eigenvalues.shape == together.offset.shape == (4, 5)
    assert together.stable.tolist() == [True, True, False, True]
    for i in range(4):
        alone = policy[i].certificate(goal[i], P[i])
        assert_close(tuple(part[i] for part in together), tuple(alone), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_stable_policy_is_certified_in_float64_whatever_its_precision(randn, dtype):
    goal = 100 * randn(2)
    policy = policy_of(stable_matrices(randn(6, 2, 2), randn(6, 2, 2), margin=0.1), goal)
    proof = policy_of(policy.A.detach().to(dtype).double(), goal).to(dtype).certificate(goal)
    assert proof.stable
    assert proof.eigenvalues.dtype == torch.float64 and proof.verdict == "proven"


@pytest.mark.parametrize(
    ("goal", "P", "message"),
    [
        (torch.zeros(3), None, "goal has to be finite and end with 2 dimensions"),
        (torch.tensor([0.0, torch.nan]), None, "goal has to be finite and end with 2 dimensions"),
        (
            torch.zeros(2),
            torch.eye(3),
            r"P has to be \(D, D\) or \(\*batch, D, D\) and fit \(2, 2\), got shape \(3, 3\)",
        ),
        (torch.zeros(2), -torch.eye(2), "P has to be symmetric positive definite"),
        (torch.zeros(2), torch.tensor([[1.0, 0.5], [0.0, 1.0]]), "P has to be symmetric positive definite"),
    ],
)
def test_a_certificate_refuses_what_it_cannot_check(random_policy, goal, P, message):
    with pytest.raises(InvalidArgumentError, match=message):
        random_policy().certificate(goal, P)


def test_a_certificate_needs_square_slopes(random_policy):
    with pytest.raises(InvalidArgumentError, match=r"as many velocities as inputs, got \(3, 2\)"):
        random_policy(O=3).certificate(torch.zeros(2))


# ---------------------------------------------------------------------- policies that stay stable while they learn


@pytest.fixture
def constrained(random_policy, randn):
    """A constrained policy with goal and P, from random slopes."""

    def make(batch=(), weighted=True, margin=0.1):
        goal, P = randn(2), metric(randn, 2, batch) if weighted else None
        return constrain(random_policy(batch=batch), goal, P, margin=margin), goal, P

    return make


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("weighted", [False, True])
def test_constraining_projects_and_ties_and_keeps_what_is_stable_already(constrained, batch, weighted):
    policy, goal, P = constrained(batch, weighted)
    assert policy.batch_shape == batch
    proof = policy.certificate(goal, P)
    assert proof.stable.all()
    assert (proof.margin >= 0.1 - 1e-12).all()
    A, b = policy.A.detach().clone(), policy.b.detach().clone()
    for name in ("b", "A"):
        parametrize.remove_parametrizations(policy, name)
    assert_close((policy.A.data, policy.b.data), (A, b))
    again = constrain(copy.deepcopy(policy), goal, P, margin=0.05)
    assert_close((again.A.data, again.b.data), (A, b), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["adam", "lbfgs"])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.slow
def test_gradients_train_a_policy_that_is_stable_at_every_evaluation(constrained, kind, weighted):
    policy, goal, P = constrained(batch=(3,), weighted=weighted)
    optim = (
        torch.optim.Adam(policy.parameters(), lr=0.05)
        if kind == "adam"
        else torch.optim.LBFGS(policy.parameters(), max_iter=4)
    )
    via, costs, margins = goal + torch.tensor([1.0, -0.5]), [], []

    def closure():
        optim.zero_grad()
        path = rollout(policy, goal + torch.tensor([1.0, 1.0]), n_steps=20, dt=0.1)
        cost = torchds.costs.via_points(path.x, via[None]).sum()
        cost.backward()
        costs.append(float(cost.detach()))
        margins.append(policy.certificate(goal, P))
        return cost

    for _ in range(40 if kind == "adam" else 10):
        optim.step(closure)
    assert costs[-1] < 0.7 * costs[0]
    assert all(proof.stable.all() and (proof.margin >= 0.1 - 1e-9).all() for proof in margins)


def test_noise_on_the_free_tensors_never_leaves_the_set(constrained):
    policy, goal, P = constrained()
    free = [p for p in policy.parameters() if p.requires_grad]
    assert len(free) == 2
    optim = PIBB(free, exploration=Gaussian(0.5), n_rollouts=10, generator=torch.Generator().manual_seed(0))
    proofs = []

    def closure():
        proofs.append(policy.certificate(goal, P))
        path = rollout(policy, goal + torch.tensor([1.0, 1.0]), n_steps=20, dt=0.1)
        return torchds.costs.via_points(path.x, (goal + torch.tensor([1.0, -0.5]))[None])

    for _ in range(5):
        optim.step(closure)
    assert proofs[0].stable.shape == (10,)
    assert all(proof.stable.all() for proof in proofs)


def test_a_constrained_policy_copies_indexes_expands_and_comes_back_from_its_state(constrained, randn):
    policy, goal, P = constrained(batch=(3,))
    x = randn(3, 5, 2)
    twin = copy.deepcopy(policy)
    assert torch.equal(twin(x), policy(x))
    with torch.no_grad():
        twin.parametrizations.A.original0.mul_(2)
    assert not torch.equal(twin(x), policy(x))
    assert_close(twin.b, -(twin.A @ goal[:, None]).squeeze(-1))  # its offsets follow its own slopes
    twin.load_state_dict(policy.state_dict())
    assert torch.equal(twin(x), policy(x))
    assert_close(policy[1](x[1]), policy(x)[1])
    assert policy[1].certificate(goal, P[1]).stable
    assert policy[1].expand(4).batch_shape == (4,)


@pytest.mark.parametrize("margin", [0.0, -1.0, float("inf"), float("nan")])
def test_a_constrained_policy_needs_a_margin(random_policy, margin):
    with pytest.raises(InvalidArgumentError, match=f"margin has to be above 0 and finite, got {margin}"):
        constrain(random_policy(), torch.zeros(2), margin=margin)
