"""Stable noise against the condition it promises, eigenvalues from scipy, and as part of an optimizer."""

import copy
import math

import numpy as np
import pytest
import scipy.linalg
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Homogeneous, Stable, TrajectorySpace
from torchds.optim import PIBB, ExponentialDecay

many = settings(max_examples=150, deadline=None)


def normal(generator, *shape):
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def make_case(seed, D, K, batch=(), metric=False, rate=0.05, skew=1.0):
    """A random policy that is stable at a random goal: (policy, goal, P), P = None for the identity."""
    g = torch.Generator().manual_seed(seed)
    root = normal(g, *batch, D, D)
    P = root @ root.mT + 0.3 * torch.eye(D, dtype=torch.float64) if metric else None
    L, W = normal(g, *batch, K, D, D), skew * normal(g, *batch, K, D, D)
    L[..., 0] *= 10 ** (-2 * torch.rand(1, generator=g, dtype=torch.float64))  # some of them near the boundary
    M = W - W.mT - L @ L.mT
    A = (M if P is None else torch.linalg.solve(P.unsqueeze(-3), M)) - rate * torch.eye(D, dtype=torch.float64)
    goal = normal(g, *batch, D)
    b = -(A @ goal[..., None, :, None]).squeeze(-1)
    means, covariances = 2 * normal(g, K, D), torch.eye(D, dtype=torch.float64).expand(K, D, D)
    return GMRPolicy(torch.full((K,), 1 / K, dtype=torch.float64), means, covariances, A, b), goal, P


def draw(exploration, n, seed=0):
    policy = exploration.policy
    g = torch.Generator().manual_seed(seed)
    parameters = list(policy.parameters())
    noise = exploration(parameters, [normal(g, n, *p.shape).to(p) for p in parameters])
    return {name: e for (name, _), e in zip(policy.named_parameters(), noise, strict=True)}


def worst(A, P=None):
    """The largest λ of (P A + Aᵀ P) u = 2 λ P u by scipy, one matrix after the other."""
    A = A.detach().numpy()
    P = np.eye(A.shape[-1]) if P is None else P.numpy()
    P = np.broadcast_to(P, A.shape)
    flat = zip(A.reshape(-1, *A.shape[-2:]), P.reshape(-1, *A.shape[-2:]), strict=True)
    return np.array([scipy.linalg.eigh(0.5 * (p @ a + a.T @ p), p, eigvals_only=True)[-1] for a, p in flat]).reshape(
        A.shape[:-2]
    )


def per_component(P):
    return None if P is None else P.unsqueeze(-3)


CASES = {
    "seed": st.integers(0, 10**6),
    "D": st.integers(1, 7),
    "K": st.integers(1, 10),
    "batch": st.sampled_from([(), (3,), (2, 2)]),
    "metric": st.booleans(),
    "std": st.sampled_from([0.01, 0.3, 10.0]),
}


# ------------------------------------------------------------------ the promise


@pytest.mark.slow
@many
@given(shrink=st.sampled_from(["all", "direction"]), eta=st.sampled_from(["closed", "stepped"]), **CASES)
def test_every_sample_is_stable_with_the_margin(seed, D, K, batch, metric, std, shrink, eta):
    policy, goal, P = make_case(seed, D, K, batch, metric)
    noise = draw(Stable(policy, Gaussian(std), goal, P, eta=eta, shrink=shrink, margin=0.04), 20, seed)
    tried = policy.A.detach() + noise["A"]
    scale = tried.abs().amax() * (1.0 if P is None else torch.linalg.cond(P).amax())
    assert worst(tried, per_component(P)).max() <= -0.04 + 1e-13 * scale
    assert torch.equal(noise["b"], -(noise["A"] @ goal[..., None, :, None]).squeeze(-1))


@many
@given(shrink=st.sampled_from(["all", "direction"]), weights_seed=st.integers(0, 99), **CASES)
@pytest.mark.slow
def test_a_convex_combination_of_samples_is_stable(seed, D, K, batch, metric, std, shrink, weights_seed):
    """Eq. 28, for weights from equal to all on one sample."""
    policy, goal, P = make_case(seed, D, K, batch, metric)
    noise = draw(Stable(policy, Gaussian(std), goal, P, shrink=shrink), 10, seed)["A"]
    g = torch.Generator().manual_seed(weights_seed)
    weights = torch.softmax(10 ** (weights_seed % 4 - 1) * normal(g, 10, *batch), 0)
    updated = policy.A.detach() + (weights[..., None, None, None] * noise).sum(0)
    assert worst(updated, per_component(P)).max() < 0


@pytest.mark.parametrize("elite", ["none", "nominal", "best"])
@pytest.mark.parametrize("shrink", ["all", "direction"])
@pytest.mark.parametrize(("D", "metric"), [(2, False), (3, True), (7, True)])
@pytest.mark.slow
def test_no_update_leaves_the_set_even_where_instability_is_rewarded(elite, shrink, D, metric):
    policy, goal, P = make_case(D, D, 4, (5,), metric)
    optim = PIBB(policy.parameters(), Stable(policy, Gaussian(0.5), goal, P, shrink=shrink), n_rollouts=8, elite=elite)
    start = policy.A.detach().clone()
    for _ in range(60):
        optim.step(lambda: -policy.A.diagonal(dim1=-2, dim2=-1).sum((-1, -2)))
        certificate = policy.certificate(goal, P)
        assert certificate.stable.all()
    assert certificate.margin.amin() > 0.99e-3
    if shrink == "all":  # the other one pulls into the set as hard as noise of this size is cut
        assert (policy.A - start).diagonal(dim1=-2, dim2=-1).sum(-1).mean() > 0  # it went where it was pulled


def test_slow_slopes_in_one_dimension_are_tied_up_to_the_rounding_of_faster_ones():
    """They have offsets that are large against themselves, which say that motions end within 1e-10 of the goal."""
    goal, slopes = torch.tensor([0.7]).double(), -torch.linspace(3.0, 30.0, 20).double()[:, None, None]
    gate = torch.full((20,), 0.05).double(), torch.zeros(20, 1).double(), torch.ones(20, 1, 1).double()
    policy = GMRPolicy(*gate, slopes, -slopes[..., 0] * goal)
    noise = Stable(policy, Gaussian(100.0), goal)(
        list(policy.parameters()), [torch.ones_like(p) for p in policy.parameters()]
    )
    with torch.no_grad():
        for parameter, change in zip(policy.parameters(), noise, strict=True):
            parameter += change
    proof = policy.certificate(goal)
    assert_close(proof.eigenvalues, torch.full((20,), -1e-3).double(), rtol=1e-5, atol=0)
    assert 1e-16 < proof.offset.max() < 1e-13 and proof.verdict == "proven"
    PIBB(policy.parameters(), Stable(policy, Gaussian(0.1), goal))
    policy.b.data += 1e-10
    assert policy.certificate(goal).verdict == "not stable"


@pytest.mark.slow
def test_a_goal_stays_a_fixed_point_over_many_updates():
    """Round-off of b + A x* is taken back at every update, so that it does not grow with their number."""
    policy, goal, _ = make_case(1, 3, 5, (4,))
    optim = PIBB(policy.parameters(), Stable(policy, Gaussian(0.3), goal), n_rollouts=5)
    apart = []
    for _ in range(1000):
        optim.step(lambda: (policy.A + torch.eye(3)).square().sum((-1, -2, -3)))
        apart.append(policy.certificate(goal).offset.amax() / policy.A.abs().amax())
    assert max(apart) < 1e-14


# ------------------------------------------------------------------ the closed form


@pytest.mark.slow
@many
@given(margin=st.sampled_from([0.0, 0.02]), **CASES)
def test_the_closed_form_is_the_largest_eta(seed, D, K, batch, metric, std, margin):
    """Against a generalised eigenvalue by scipy, and against bisection."""
    policy, _, P = make_case(seed, D, K, batch, metric)
    A, E = policy.A.detach(), std * normal(torch.Generator().manual_seed(seed), *policy.A.shape)
    eta = Stable.shrinkage(A, E, per_component(P), margin=margin)
    assert eta.shape == A.shape[:-2]
    lever = torch.eye(D, dtype=torch.float64).expand(*batch, D, D) if P is None else P
    for index in np.ndindex(*A.shape[:-2]):
        a, e, p = A[index].numpy(), E[index].numpy(), lever[index[:-1]].numpy()
        W, S = -0.5 * (p @ a + a.T @ p) - margin * p, 0.5 * (p @ e + e.T @ p)
        largest = scipy.linalg.eigh(S, W, eigvals_only=True)[-1]
        assert eta[index] == pytest.approx(min(1.0, 1.0 / largest) if largest > 0 else 1.0, rel=0, abs=1e-10)
    index = tuple(np.unravel_index(seed % eta.numel(), eta.shape))
    a, e, p = A[index].numpy(), E[index].numpy(), lever[index[:-1]].numpy()
    low, high = 0.0, 1.0
    if worst(torch.from_numpy(a + e), torch.from_numpy(p)) <= -margin:
        low = 1.0
    for _ in range(50 * (low < high)):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if worst(torch.from_numpy(a + middle * e), torch.from_numpy(p)) <= -margin else (low, middle)
        )
    assert eta[index] == pytest.approx(low, rel=0, abs=1e-9)


def test_the_largest_step_puts_an_eigenvalue_on_the_boundary():
    a, s = -torch.tensor([[1.0, 0.3], [0.3, 0.5]]).double(), torch.tensor([[0.4, -1.0], [-1.0, 0.2]]).double()
    eta = Stable.shrinkage(a, s)
    assert 0 < eta < 1
    assert abs(torch.linalg.eigvalsh(a + eta * s)[-1]) < 1e-15
    assert Stable.shrinkage(a, -a) == 1.0
    assert Stable.shrinkage(a, a) == 1.0
    assert Stable.shrinkage(-a, s) == 0.0
    assert Stable.shrinkage(a, s, margin=0.9) == 0.0


@pytest.mark.slow
@many
@given(**CASES)
def test_the_stepped_factor_is_the_first_that_passes_the_papers_loop(seed, D, K, batch, metric, std):
    policy, goal, P = make_case(seed, D, K, batch, metric)
    raw = std * normal(torch.Generator().manual_seed(seed), 4, *policy.A.shape)
    closed, stepped = (Stable(policy, Gaussian(std), goal, P, eta=eta) for eta in ("closed", "stepped"))
    noise = stepped.stabilise(raw)
    A, Pk = policy.A.detach(), per_component(P)
    turned = raw.mT if P is None else torch.linalg.solve(Pk, raw.mT @ Pk)
    symmetric, rest = 0.5 * (raw + turned), 0.5 * (raw - turned)
    margin = torch.from_numpy(-worst(A, Pk)).clamp(max=1e-3)
    expected, done = torch.zeros_like(raw), torch.zeros(raw.shape[:-2], dtype=torch.bool)
    for step in [i / 10 for i in range(10, -1, -1)]:
        candidate = step * symmetric + rest
        passes = ~done & (torch.from_numpy(worst(A + candidate, Pk)) < -margin + 1e-9)
        expected[passes], done = candidate[passes], done | passes
    # The two may differ where the boundary lies within round-off of a step.
    eta = Stable.shrinkage(A, raw, Pk, margin=(1 - 1e-6) * margin)
    clear = ((10 * eta).round() - 10 * eta).abs() > 1e-4
    assert_close(noise[clear], expected[clear], rtol=1e-8, atol=1e-10)
    assert (
        torch.linalg.matrix_norm(noise - rest) <= torch.linalg.matrix_norm(closed.stabilise(raw) - rest) + 1e-9
    ).all()


# ------------------------------------------------------------------ shrinking a direction


@pytest.mark.slow
@many
@given(**CASES)
def test_shrinking_a_direction_gives_the_nearest_stable_slopes(seed, D, K, batch, metric, std):
    policy, goal, P = make_case(seed, D, K, batch, metric)
    raw = std * normal(torch.Generator().manual_seed(seed), 3, *policy.A.shape)
    A, Pk = policy.A.detach(), per_component(P)
    noise = {
        shrink: Stable(policy, Gaussian(std), goal, P, shrink=shrink).stabilise(raw) for shrink in ("all", "direction")
    }
    inside = torch.from_numpy(worst(A + raw, Pk)) < -1.01e-3
    assert torch.equal(noise["direction"][inside], raw[inside])
    assert torch.equal(noise["all"][inside], raw[inside])
    # Never further from the raw noise than scaling is, in the coordinates of P.
    C = torch.eye(D, dtype=torch.float64) if P is None else torch.linalg.cholesky(Pk).mT
    distance = {k: torch.linalg.matrix_norm(C @ (raw - e) @ torch.linalg.inv(C)) for k, e in noise.items()}
    assert (distance["direction"] <= distance["all"] + 1e-6 * raw.abs().amax()).all()


def test_a_policy_on_the_boundary_is_starved_by_one_factor_and_explored_by_directions():
    """Many draws are pushed over the boundary and shrunk to nothing; cutting that direction leaves the others."""
    A = torch.diag(torch.tensor([-0.001, -1.0], dtype=torch.float64))[None]
    policy = GMRPolicy(torch.ones(1).double(), torch.zeros(1, 2).double(), torch.eye(2)[None].double(), A, A[:, 0] * 0)
    goal = torch.zeros(2, dtype=torch.float64)
    n, std = 4000, 0.03
    raw = std * normal(torch.Generator().manual_seed(0), n, 1, 2, 2)
    free = {
        shrink: Stable(policy, Gaussian(std), goal, shrink=shrink, margin=1e-4).stabilise(raw)
        for shrink in ("all", "direction")
    }
    starved = (free["all"][:, 0, 1, 1] / raw[:, 0, 1, 1]).abs() < 0.1
    assert starved.double().mean() > 0.35
    kept = (free["direction"][:, 0, 1, 1] / raw[:, 0, 1, 1] - 1).abs() < 0.1
    assert kept.double().mean() > 0.95


# ------------------------------------------------------------------ limiting cases


@pytest.mark.parametrize("options", [{}, {"eta": "stepped"}, {"shrink": "direction"}, {"shrink": "none"}])
@pytest.mark.parametrize("metric", [False, True])
def test_small_noise_is_raw_noise_and_no_noise_is_none(options, metric):
    policy, goal, P = make_case(3, 4, 5, (2,), metric)
    g = torch.Generator().manual_seed(0)
    parameters = list(policy.parameters())
    normals = [1e-3 * normal(g, 50, *p.shape) for p in parameters]
    raw = Stable(policy, Gaussian(1.0), goal, P, **options)(parameters, normals)
    assert torch.equal(raw[0], normals[0])
    assert not any(e.any() for e in Stable(policy, Gaussian(0.0), goal, P, **options)(parameters, normals))


def test_without_shrinking_only_b_is_tied():
    policy, goal, _ = make_case(4, 2, 3)
    noise = draw(Stable(policy, Gaussian(5.0), goal, shrink="none"), 200)
    assert worst(policy.A.detach() + noise["A"]).max() > 1.0
    assert noise["A"].std() == pytest.approx(5.0, rel=0.1)
    assert torch.equal(noise["b"], -(noise["A"] @ goal[:, None]).squeeze(-1))


def test_antisymmetric_noise_is_never_shrunk():
    policy, goal, _ = make_case(5, 3, 4)
    raw = 50 * normal(torch.Generator().manual_seed(0), 6, *policy.A.shape)
    kept = Stable(policy, Gaussian(1.0), goal).stabilise(raw)
    assert_close(kept - kept.mT, raw - raw.mT, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shrink", ["all", "direction"])
@pytest.mark.parametrize("metric", [False, True])
def test_a_batch_equals_its_policies_one_by_one(shrink, metric):
    policy, goal, P = make_case(6, 3, 4, (5,), metric)
    raw = 2 * normal(torch.Generator().manual_seed(0), 7, *policy.A.shape)
    together = Stable(policy, Gaussian(1.0), goal, P, shrink=shrink).stabilise(raw)
    for r in range(5):
        alone = Stable(policy[r], Gaussian(1.0), goal[r], None if P is None else P[r], shrink=shrink)
        assert_close(alone.stabilise(raw[:, r]), together[:, r], rtol=1e-9, atol=1e-11)


def test_one_goal_and_one_metric_serve_a_batch():
    policy, goal, P = make_case(7, 2, 3, (), True)
    noise = draw(Stable(policy.expand(4), Gaussian(1.0), goal, P), 6)
    assert noise["A"].shape == (6, 4, 3, 2, 2)
    assert worst(policy.A.detach() + noise["A"], P).max() < 0


def test_float32_stays_float32_and_stable():
    policy, goal, P = make_case(8, 3, 4, (), True)
    policy = policy.float()
    with torch.no_grad():
        policy.b.copy_(-(policy.A @ goal.float()).squeeze(-1))
    noise = draw(Stable(policy, Gaussian(2.0), goal.float(), P.float(), margin=0.02), 100)
    assert noise["A"].dtype == noise["b"].dtype == torch.float32
    assert worst((policy.A.detach() + noise["A"]).double(), P).max() < -0.019


def test_stiffness_is_left_alone():
    policy, goal, _ = make_case(9, 2, 3)
    rows = torch.zeros(3, 1, 2, dtype=torch.float64), torch.full((3, 1), 20.0, dtype=torch.float64)
    policy = GMRPolicy(policy.priors, policy.means, policy.covariances, policy.A, policy.b, *rows)
    noise = draw(Stable(policy, Gaussian(0.1), goal), 5)
    assert noise["A"].all()
    assert not noise["stiffness_A"].any()
    assert not noise["stiffness_b"].any()


def test_the_certificate_is_what_is_logged():
    policy, goal, P = make_case(10, 3, 4, (5,), True)
    scalars = Stable(policy, Gaussian(0.1), goal, P).scalars()
    assert scalars == {
        "stability/largest_eigenvalue": pytest.approx(worst(policy.A, per_component(P)).max(), abs=1e-12)
    }


# ------------------------------------------------------------------ along the motion


def along(policy, goal, P=None, spread=0.3, shrink="direction", **options):
    x0 = goal + torch.tensor([1.5, -1.0], dtype=torch.float64)
    space = TrajectorySpace(policy, x0, 20, 0.1, spread, goal=goal, **options)
    return Stable(policy, space, goal, P, shrink=shrink)


@pytest.mark.parametrize("metric", [False, True])
@pytest.mark.parametrize("shrink", ["all", "direction"])
@pytest.mark.slow
def test_along_the_motion_it_stays_stable_too(metric, shrink):
    policy, goal, P = make_case(11, 2, 3, (), metric)
    exploration = along(policy.expand(3), goal, P, spread=2.0, shrink=shrink)
    noise = draw(exploration, 100)
    assert worst(policy.A.detach() + noise["A"], per_component(P)).max() < -0.99e-3
    assert torch.equal(noise["b"], -(noise["A"] @ goal[:, None]).squeeze(-1))
    raw = draw(exploration.raw, 100)
    assert worst(policy.A.detach() + raw["A"], per_component(P)).max() > 0  # there was something to do


def test_the_covariance_of_tied_parameters_is_that_of_a_jacobian_with_respect_to_A():
    """J_A by autograd through a roll-out whose b is −A x*."""
    policy, goal, _ = make_case(12, 2, 3)
    spread, widening, mean_speed = 0.2, 2.0, 0.4
    space = along(policy, goal, spread=spread, widening=widening, mean_speed=mean_speed, damping=0.0).raw

    def motion(a):
        moved = copy.deepcopy(policy)
        del moved.A, moved.b
        moved.A = a
        moved.b = -(a @ goal[:, None]).squeeze(-1)
        return rollout(moved, space.x0, 20, 0.1).x[1:].flatten()

    J = torch.func.jacrev(motion)(policy.A.detach()).flatten(1).numpy()  # (T D, K O D)
    distance = sum(
        math.sqrt(((m - goal) ** 2).sum() + torch.trace(S)) / 3
        for m, S in zip(policy.means, policy.covariances, strict=True)
    )
    std = widening * mean_speed / math.sqrt(math.pi / 2) / distance
    C = np.linalg.inv(J.T @ J / (20 * spread**2) + np.eye(12) / std**2)
    index = policy.split(torch.arange(18))["A"].flatten()
    np.testing.assert_allclose(space.covariance[index][:, index], C, rtol=0, atol=1e-10 * np.abs(C).max())
    noise = draw(space, 5)
    assert_close(noise["b"], -(noise["A"] @ goal[:, None]).squeeze(-1), rtol=1e-12, atol=1e-14)


@pytest.mark.slow
def test_a_run_along_the_motion_continues_from_a_checkpoint_bit_for_bit(tmp_path):
    def learner():
        policy, goal, _ = make_case(13, 2, 3)
        optim = PIBB(policy.parameters(), along(policy, goal, refresh=3), n_rollouts=5)
        return policy, optim, torch.optim.lr_scheduler.LambdaLR(optim, ExponentialDecay(8))

    def learn(policy, optim, decay, updates):
        for _ in range(updates):
            optim.step(lambda: (policy.A + 1).square().sum((-1, -2, -3)))
            decay.step()

    whole, half, resumed = learner(), learner(), learner()
    learn(*whole, 8)
    learn(*half, 4)
    torch.save([part.state_dict() for part in half], tmp_path / "run.pt")
    for part, state in zip(resumed, torch.load(tmp_path / "run.pt", weights_only=True), strict=True):
        part.load_state_dict(state)
    learn(*resumed, 4)
    assert torch.equal(whole[0].pack(), resumed[0].pack())


# ------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"raw": 0.5}, r"raw has to be an exploration, got 0.5; use Gaussian\(0.5\) for a number"),
        ({"eta": "open"}, "eta has to be one of 'closed', 'stepped', got 'open'"),
        ({"shrink": "some"}, "shrink has to be one of 'all', 'direction', 'none', got 'some'"),
        ({"margin": 0.0}, "margin has to be finite and positive, got 0.0"),
        ({"goal": torch.zeros(3, dtype=torch.float64)}, "goal has to be finite and end with 2"),
        ({"P": -torch.eye(2, dtype=torch.float64)}, "P has to be symmetric positive definite"),
    ],
)
def test_arguments_out_of_range_are_refused(options, words):
    policy, goal, _ = make_case(0, 2, 3)
    with pytest.raises(InvalidArgumentError, match=words):
        Stable(**{"policy": policy, "raw": Gaussian(0.1), "goal": goal, **options})


def test_an_optimizer_refuses_what_cannot_be_kept_stable():
    policy, goal, _ = make_case(0, 2, 3)
    with pytest.raises(InvalidArgumentError, match=r"ties b to A; \['b'\] of the policy is not in the group"):
        PIBB([policy.A], Stable(policy, Gaussian(0.1), goal))
    with pytest.raises(InvalidArgumentError, match=r"b differs from −A x\* by up to .*; give the goal of its fit"):
        PIBB(policy.parameters(), Stable(policy, Gaussian(0.1), goal + 1.0))
    other = make_case(1, 2, 3)[0]
    with pytest.raises(InvalidArgumentError, match="Homogeneous explores"):
        PIBB(policy.parameters(), Stable(policy, Homogeneous(other), goal))
    with torch.no_grad():
        policy.A.add_(9 * torch.eye(2))
        policy.b.copy_(-(policy.A @ goal[:, None]).squeeze(-1))
    with pytest.raises(InvalidArgumentError, match=r"the policy is not stable: .* fit one with torchds.fit_stable"):
        PIBB(policy.parameters(), Stable(policy, Gaussian(0.1), goal))
    PIBB(policy.parameters(), Stable(policy, Gaussian(0.1), goal, shrink="none"))


def test_a_tied_space_needs_a_goal_of_the_inputs():
    policy, _, _ = make_case(0, 2, 3)
    with pytest.raises(InvalidArgumentError, match=r"goal has to be \(2,\), got \(3,\)"):
        TrajectorySpace(policy, torch.zeros(2).double(), 5, 0.1, 0.1, goal=torch.zeros(3).double())
