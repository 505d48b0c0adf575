"""Dynamic movement primitives: the differential equation of the paper, integrated by others, and its limiting cases."""

import copy

import numpy as np
import pytest
import scipy.integrate
import torch

from tests.motions import refuses, two
from torchds import Demonstrations, GMRPolicy, visits
from torchds.costs import control_cost
from torchds.dmp import ALPHA_S, ALPHA_Z, DMP
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PI2, PIBB

GOAL = torch.tensor([1.0, -2.0], dtype=torch.float64)


@pytest.fixture
def primitive():
    generator = torch.Generator().manual_seed(0)
    return DMP(20 * torch.randn(6, 2, dtype=torch.float64, generator=generator), GOAL, 2.0)


def printed(primitive, y, z, s):
    """The right-hand sides as they are printed, for one primitive, in numpy."""
    c = np.exp(-ALPHA_S * np.linspace(0, 1, primitive.n_components))
    width = np.append(-np.diff(c), -np.diff(c)[-1])
    psi = np.exp(-((s - c) ** 2) / (2 * width**2))
    w = primitive.A.detach().numpy()[..., 0]
    beta = ALPHA_Z / 4
    f = ALPHA_Z * beta * (psi @ w) / psi.sum() * s
    tau = primitive.duration
    return z / tau, (ALPHA_Z * (beta * (GOAL.numpy() - y) - z) + f) / tau, -ALPHA_S * s / tau


def test_a_rollout_is_the_differential_equation_as_printed(primitive):
    """An error of first order in the time step, against scipy's of 1e-10."""

    def field(t, state):
        return np.concatenate([np.atleast_1d(d) for d in printed(primitive, state[:2], state[2:4], state[4])])

    start = np.array([0.5, 0.5])
    exact = scipy.integrate.solve_ivp(field, (0, 2), [*start, 0, 0, 1], rtol=1e-10, atol=1e-10).y[:2, -1]
    errors = [np.abs(primitive.rollout(start, n, 2 / n).x[-1].detach().numpy() - exact).max() for n in (1000, 2000)]
    assert errors[1] < 0.02 and errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)


def test_a_rollout_is_one_step_after_the_other(primitive):
    """From two starts, for a batch of three, against single loops in numpy; the phase of Euler's loop is exact."""
    batch = primitive.expand(3)
    batch.A.data[1] *= 2
    starts, T, dt = np.array([[0.0, 0.0], [3.0, 1.0]]), 40, 0.05
    path = batch.rollout(starts, T, dt)
    assert path.x.shape == (3, 2, T + 1, 2) and path.v.shape == (3, 2, T, 2) and path.inputs.shape == (3, 2, T, 1)
    for b in range(3):
        for p, start in enumerate(starts):
            y, z, track = start, np.zeros(2), [start]
            for t in range(T):
                dy, dz, _ = printed(batch[b], y, z, np.exp(-ALPHA_S * t * dt / 2))
                y, z = y + dt * dy, z + dt * dz
                track.append(y)
            np.testing.assert_allclose(path.x[b, p].detach(), track, rtol=0, atol=1e-9)
    now, track = batch.begin(starts), []
    for _ in range(T):
        track.append(now.y)
        now = batch.step(now, dt)
    torch.testing.assert_close(path.x, torch.stack([*track, now.y], -2), rtol=0, atol=1e-9)
    assert float(now.s) == pytest.approx(np.exp(-ALPHA_S))


def test_without_weights_it_is_a_critically_damped_spring():
    """Y(t) = g + (y₀ − g) (1 + ω t) exp(−ω t), ω = α_z / 2τ."""
    still, n = DMP(torch.zeros(4, 2, dtype=torch.float64), GOAL, 2.0), 2000
    t, omega = 2 / n * torch.arange(n + 1, dtype=torch.float64)[:, None], ALPHA_Z / 4
    expected = GOAL * (1 - (1 + omega * t) * torch.exp(-omega * t))
    torch.testing.assert_close(still.rollout(torch.zeros(2), n, 2 / n).x, expected, rtol=0, atol=5e-3)


def test_the_goal_is_where_it_ends_whatever_the_weights_and_the_start(primitive):
    path = primitive.rollout(torch.tensor([[5.0, 5.0], [-9.0, 0.0]]), 800, 0.01)
    assert (path.x[:, -1] - GOAL).abs().max() < 1e-3


def test_the_response_is_the_jacobian_of_the_motion(primitive):
    jacobian = torch.autograd.functional.jacobian(
        lambda A: torch.func.functional_call(_Motion(primitive), {"primitive.A": A}, ()), primitive.A.detach()
    )[..., 0]  # (T, O, K, O)
    response = primitive.response(15, 0.1)
    for o in range(2):
        torch.testing.assert_close(jacobian[:, o, :, o], response, rtol=0, atol=1e-12)
    assert jacobian[:, 0, :, 1].abs().max() == 0


class _Motion(torch.nn.Module):
    def __init__(self, primitive):
        super().__init__()
        self.primitive = primitive

    def forward(self):
        return self.primitive.rollout(torch.zeros(2), 15, 0.1).x[1:]


def test_a_fit_gives_back_the_weights_behind_a_motion(primitive):
    """Finite differences of the fit see the acceleration half a step late, hence fine steps."""
    path = primitive.rollout(torch.zeros(2), 1000, 2 / 1000)
    x = path.x.detach()
    demo = Demonstrations([x[:-1]], [path.v.detach()], 2 / 1000)
    fitted = DMP.fit(demo, 6, GOAL, rest=0.0)
    again = fitted.rollout(torch.zeros(2), 1000, 2 / 1000).x
    assert fitted.duration == pytest.approx(2.0, rel=2e-3)
    assert (again - x).abs().max() < 0.05 * (x - x.mean(0)).abs().max()


def test_a_fit_that_rests_at_the_goal_stays_there():
    """A motion that stops at once: x = t² for 0 ≤ t ≤ 1, and nothing says what follows."""
    t = torch.linspace(0, 1, 101, dtype=torch.float64)[:, None]
    demo = Demonstrations([t**2 - 1], [2 * t], 0.01)
    after = [DMP.fit(demo, 8, rest=rest).rollout([-1.0], 200, 0.01).x[100:].abs().max() for rest in (0.0, 0.25)]
    assert after[1] < 0.5 * after[0]


def test_a_fit_follows_demonstrations():
    demos = two()[:1]
    path = DMP.fit(demos, 12, rest=0.0).rollout(demos[0].x[0], 100, demos[0].dt)
    assert (path.x - demos[0].x).abs().max() < 0.2 * (demos[0].x.amax(0) - demos[0].x.amin(0)).max()


def test_rollouts_report_features_of_which_the_forcing_term_is_linear(primitive):
    with visits.listen() as seen:
        path = primitive.rollout(torch.zeros(2), 10, 0.1)
    (visit,) = seen
    assert visit.policy is primitive and torch.equal(visit.features, path.features)
    forces = visit.features @ primitive.rows().mT
    assert torch.equal(forces, primitive(path.inputs))
    gating = primitive.feature_gating(visit.features)
    for found in (gating[..., ::2], path.gating):
        torch.testing.assert_close(found, primitive.gating(path.inputs), rtol=0, atol=1e-12)


def test_the_control_cost_projects_on_the_basis_alone(primitive):
    """Υ of Algorithm 1 with the matrices as printed, for one row: θ = w, G = ψ s / Σ ψ."""
    g = primitive.features(torch.tensor([[0.3]], dtype=torch.float64))  # (1, 2K)
    noise = torch.zeros(2, 12, dtype=torch.float64)
    noise[:, ::2] = torch.arange(12.0).reshape(2, 6)
    G = g[0, ::2]
    M = G[:, None] @ G[None] / (G @ G)
    expected = sum((M @ row).square().sum() for row in noise[:, ::2])
    found = control_cost(torch.zeros_like(noise), noise, g, 1.0)
    torch.testing.assert_close(found, expected[None], rtol=1e-12, atol=0)


def test_a_search_moves_the_weights_and_not_the_offsets(primitive):
    before = copy.deepcopy(primitive.state_dict())
    optim = PIBB(primitive.parameters(), exploration=Gaussian([1.0, 0.0]), n_rollouts=8, control_weight=1e-6)
    costs = [
        float(optim.step(lambda: primitive.rollout(torch.zeros(2), 20, 0.1).x[..., 10, :].square().sum(-1)))
        for _ in range(30)
    ]
    assert costs[-1] < 0.5 * costs[0]
    assert torch.equal(primitive.b, before["b"]) and not torch.equal(primitive.A, before["A"])


def test_a_roll_out_that_failed_has_no_part_in_the_time_average(primitive):
    """As if the others had been all."""

    other, normals = copy.deepcopy(primitive), torch.randn(4, *primitive.A.shape, dtype=torch.float64)
    optim = PI2([primitive.A], exploration=Gaussian(1.0), n_rollouts=4)
    optim.ask([[normals]])
    with visits.listen() as seen:
        tried = copy.deepcopy(primitive)
        tried.A.data = primitive.A + normals
        costs = tried.rollout(torch.zeros(2), 20, 0.1).x[..., 1:, :].square().sum(-1)
    costs[0] = torch.nan
    visited = [visits.Visit(primitive, seen[0].features)]
    optim.tell(costs, visited)
    alone = PI2([other.A], exploration=Gaussian(1.0), n_rollouts=3)
    alone.ask([[normals[1:]]])
    alone.tell(costs[1:], [visits.Visit(other, seen[0].features[1:])])
    torch.testing.assert_close(primitive.A, other.A, rtol=1e-12, atol=1e-12)


def test_it_is_a_policy_of_its_parameters(primitive):
    assert isinstance(primitive, GMRPolicy) and primitive.batch_shape == ()
    assert sum(p.numel() for p in primitive.parameters() if p.requires_grad) == 12
    batch = primitive.expand(4)
    assert not batch.b.requires_grad and torch.equal(batch[2].A, primitive.A) and torch.equal(batch[2].goal, GOAL)
    other = DMP(torch.zeros(6, 2, dtype=torch.float64), torch.zeros(2), 5.0)
    other.load_state_dict(primitive.state_dict())
    assert torch.equal(other.rollout(GOAL, 5, 0.1).x, primitive.rollout(GOAL, 5, 0.1).x)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: DMP(torch.zeros(1, 2), torch.zeros(2), 1.0), "K of at least 2, got (1, 2)"),
        (lambda: DMP(torch.zeros(4, 2), torch.zeros(3), 1.0), "goal has to be (2,)"),
        (lambda: DMP(torch.zeros(4, 2), torch.zeros(2), 0.0), "duration has to be positive"),
        (lambda: DMP(torch.zeros(4, 2), torch.zeros(2), 1.0).rollout(torch.zeros(3), 5, 0.1), "end with 2 dimensions"),
        (lambda: DMP(torch.zeros(4, 2), torch.zeros(2), 1.0).rollout(torch.zeros(2), 5, 0.0), "dt has to be positive"),
        (lambda: DMP(torch.zeros(4, 2), torch.zeros(2), 1.0).save("primitive.pt"), "a file of a policy has no phase"),
    ],
)
def test_what_does_not_fit_is_refused(call, words):
    with refuses(InvalidArgumentError, words):
        call()
