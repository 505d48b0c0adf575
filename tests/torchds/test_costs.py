import numpy as np
import pytest
import scipy.linalg
import torch
from torch.testing import assert_close

from torchds import costs

CLOSE = {"rtol": 1e-12, "atol": 1e-12}


def each(function, *batched):
    """`function` of each entry along the first axis, in numpy."""
    return np.array([function(*entries) for entries in zip(*(b.numpy() for b in batched), strict=True)])


def test_via_points_by_hand():
    x = torch.tensor([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    # the first is passed exactly, the second at a distance of 1, the third is the start, which does not count
    assert costs.via_points(x, torch.tensor([[2.0, 0.0], [1.0, 1.0], [0.0, 0.0]])) == 0 + 1 + 1


def test_via_points_equal_a_loop(randn):
    x, points = randn(5, 8, 2), randn(3, 2)
    expected = each(lambda x: sum(min(((p - x_j) ** 2).sum() for x_j in x[1:]) for p in points.numpy()), x)
    assert_close(costs.via_points(x, points).numpy(), expected, **CLOSE)
    nested = x.expand(4, 5, 8, 2)
    assert_close(costs.via_points(nested, points), costs.via_points(x, points).expand(4, 5), rtol=0, atol=0)


def test_goal_is_the_squared_distance_at_the_end(randn):
    x, target = randn(5, 8, 3), randn(3)
    expected = each(lambda x: ((target.numpy() - x[-1]) ** 2).sum(), x)
    assert_close(costs.goal(x, target).numpy(), expected, **CLOSE)


def test_intrusion_equals_a_loop_and_the_start_does_not_count(randn):
    x, centres, radii = randn(5, 8, 2), randn(3, 2), torch.tensor([0.5, 1.0, 1e-3], dtype=torch.float64)

    def loop(x):
        discs = list(zip(centres.numpy(), radii.numpy(), strict=True))
        return sum(max(max(r - np.linalg.norm(x_j - c), 0.0) for x_j in x[1:]) ** 2 for c, r in discs)

    expected = each(loop, x)
    assert (expected > 0).any()
    assert_close(costs.intrusion(x, centres, radii).numpy(), expected, **CLOSE)
    inside, outside = torch.zeros(1, 2).double(), torch.ones(4, 2).double()
    assert costs.intrusion(torch.cat([inside, outside]), [[0.0, 0.0]], [1.0]) == 0
    assert costs.intrusion(torch.cat([outside, inside]), [[0.0, 0.0]], [1.0]) == 1


def test_the_gradient_of_intrusion_pushes_the_deepest_state_out():
    x = torch.tensor([[9.0, 0.0], [0.5, 0.0], [0.25, 0.0], [3.0, 0.0]], dtype=torch.float64, requires_grad=True)
    costs.intrusion(x, [[0.0, 0.0]], [1.0]).backward()
    assert x.grad.tolist() == [[0, 0], [0, 0], [-1.5, 0], [0, 0]]


def test_acceleration_is_the_sum_of_velocity_steps(randn):
    v = randn(5, 8, 2)
    expected = each(lambda v: sum(np.linalg.norm(v[j] - v[j - 1]) for j in range(1, 8)), v)
    assert_close(costs.acceleration(v).numpy(), expected, **CLOSE)
    assert costs.acceleration(torch.ones(8, 2)) == 0


def test_path_length_is_the_sum_of_the_steps(randn):
    x = randn(5, 9, 2)
    v = x.diff(dim=-2) / 0.1
    expected = each(lambda x: sum(np.linalg.norm(x[j + 1] - x[j]) for j in range(8)), x)
    assert_close(costs.path_length(v, 0.1).numpy(), expected, **CLOSE)


def test_stiffness_is_the_sum_of_norms(randn):
    s = randn(5, 8, 2)
    expected = each(lambda s: sum(np.linalg.norm(s_j) for s_j in s), s)
    assert_close(costs.stiffness(s).numpy(), expected, **CLOSE)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_costs_keep_the_dtype(randn, dtype):
    x, rows = randn(4, 6, 2).to(dtype), randn(4, 2, 5).to(dtype)
    terms = (
        costs.via_points(x, x[0, :2]),
        costs.goal(x, x[0, 0]),
        costs.acceleration(x),
        costs.path_length(x, 0.1),
        costs.stiffness(x),
        costs.control_cost(rows, rows, randn(4, 7, 5).to(dtype), 0.5).sum(-1),
    )
    assert all(term.dtype == dtype and term.shape == (4,) for term in terms)


@pytest.mark.parametrize("term", [costs.via_points, costs.goal, costs.acceleration, costs.path_length, costs.stiffness])
def test_terms_differentiate(randn, term):
    extra = {costs.via_points: [randn(3, 2)], costs.goal: [randn(2)], costs.path_length: [0.1]}.get(term, [])
    torch.autograd.gradcheck(lambda x: term(x, *extra), (randn(2, 5, 2).requires_grad_(),))


# ---------------------------------------------------------------------- the control cost of Algorithm 1


def control_cost_as_printed(deviation, noise, G, R):
    """Lines 15-16 with their P×P matrices; parameters of zero weight take no part."""
    controlled = R > 0
    deviation, noise, G, R = deviation[controlled], noise[controlled], G[:, controlled], np.diag(R[controlled])
    R_inverse = np.linalg.inv(R)
    # an output none of whose parameters is controlled has a zero row in G: the pseudoinverse leaves it out
    M = R_inverse @ G.T @ np.linalg.pinv(G @ R_inverse @ G.T, rcond=1e-14, hermitian=True) @ G
    u = deviation + M @ noise
    return u @ R @ u


def dense(deviation, noise, features, weight):
    """The printed formula along one roll-out, for rows (O, F)."""
    deviation, noise, weight = (m.numpy().ravel() for m in (deviation, noise, weight))
    O = len(deviation) // features.shape[-1]
    G = [scipy.linalg.block_diag(*[g[None]] * O) for g in features.numpy()]
    return np.array([control_cost_as_printed(deviation, noise, G_t, weight) for G_t in G])


def some_weights(randn, kind, shape):
    weight = {"scalar": torch.full(shape, 0.0005, dtype=torch.float64), "zero": torch.zeros(shape, dtype=torch.float64)}
    diagonal = randn(*shape).exp()
    free = diagonal.clone()
    free[..., ::2] = 0.0
    row = diagonal.clone()
    row[..., 1, :] = 0.0
    return (weight | {"diagonal": diagonal, "some zero": free, "a row of zeros": row})[kind]


@pytest.mark.parametrize("kind", ["scalar", "diagonal", "some zero", "a row of zeros", "zero"])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_control_cost_is_the_printed_one(randn, kind, batch):
    O, T, F = 3, 5, 6
    deviation, noise, features = randn(*batch, O, F), randn(*batch, O, F), randn(*batch, T, F)
    weight = some_weights(randn, kind, (*batch, O, F))
    cost = costs.control_cost(deviation, noise, features, weight)
    assert cost.shape == (*batch, T)
    for i in np.ndindex(batch):
        expected = dense(deviation[i], noise[i], features[i], weight[i])
        assert_close(cost[i].numpy(), expected, rtol=1e-10, atol=1e-12)


def test_control_cost_takes_a_number_or_the_diagonal_of_R(randn):
    deviation, noise, features = randn(4, 2, 6), randn(4, 2, 6), randn(4, 5, 6)
    cost = costs.control_cost(deviation, noise, features, 0.3)
    assert_close(costs.control_cost(deviation, noise, features, torch.full((2, 6), 0.3)), cost, rtol=1e-7, atol=0)
    assert_close(costs.control_cost(deviation, noise, features, 0.6), 2 * cost, **CLOSE)


def test_control_cost_of_a_policy_is_that_of_its_basis_and_theta(random_policy, randn):
    policy, x = random_policy(Q=1), randn(5, 2)
    initial = policy.pack().detach()
    policy.unpack(initial + randn(*initial.shape))
    epsilon = randn(*initial.shape)
    noise = policy.rows(dict(zip(policy.parameters(), policy.split(epsilon).values(), strict=True)).__getitem__)
    cost = costs.control_cost(policy.rows() - policy.initial_rows, noise, policy.features(x), 0.0005)
    theta = (policy.pack() - initial).detach().numpy()
    R = np.full(len(theta), 0.0005)
    expected = [control_cost_as_printed(theta, epsilon.numpy(), G, R) for G in policy.basis(x).detach().numpy()]
    assert_close(cost.detach().numpy(), np.array(expected), rtol=1e-10, atol=1e-12)


def test_without_noise_the_control_cost_is_the_weighted_deviation(randn):
    deviation, features = randn(2, 6), randn(5, 6)
    cost = costs.control_cost(deviation, torch.zeros(2, 6, dtype=torch.float64), features, 0.5)
    assert_close(cost, (0.5 * deviation.square().sum()).expand(5), **CLOSE)


def test_noise_that_the_features_do_not_see_is_free(randn):
    g, noise, nothing = randn(6), randn(2, 6), torch.zeros(2, 6, dtype=torch.float64)
    unseen = noise - (noise @ g / g.square().sum())[:, None] * g
    assert_close(costs.control_cost(nothing, unseen, g[None], 0.5), torch.zeros(1, dtype=torch.float64), **CLOSE)
    assert costs.control_cost(nothing, noise, g[None], 0.5) > 1e-3
