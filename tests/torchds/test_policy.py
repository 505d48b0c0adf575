import copy
import math
import pickle
import re
from fractions import Fraction

import numpy as np
import pytest
import torch
from torch.func import functional_call, stack_module_state, vmap
from torch.testing import assert_close

from torchds import Demonstrations, GaussianMixture, GMRPolicy
from torchds.errors import DegenerateMixtureError, InvalidArgumentError

SIZES = {
    "one dimension": {"K": 2, "D": 1, "O": 1},
    "plane": {"K": 3, "D": 2, "O": 2},
    "one component": {"K": 1, "D": 2, "O": 2},
    "more velocities than inputs": {"K": 3, "D": 2, "O": 3},
    "one stiffness": {"K": 3, "D": 2, "O": 2, "Q": 1},
    "two stiffnesses": {"K": 4, "D": 3, "O": 3, "Q": 2},
}
sizes = pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)


# ---------------------------------------------------------------------- the field, Eq. 1-3, 8-9, 34


@sizes
def test_everything_is_as_printed(random_mixture, gmr_as_printed, randn, size):
    size = {"Q": 0} | size
    K, D, O, Q = size["K"], size["D"], size["O"], size["Q"]
    mixture = random_mixture(K, D + O + Q)
    policy = GMRPolicy.from_mixture(mixture, D, stiffness_dim=Q)
    for x in randn(5, D):
        h, A, b, y = gmr_as_printed(mixture, x)
        G = []
        for k in range(K):  # Eq. 9 and 43: Dim_in slopes for each output along a diagonal of blocks, then the identity
            block = np.zeros((O + Q, (O + Q) * (D + 1)))
            for o in range(O + Q):
                block[o, o * D : (o + 1) * D] = x
                block[o, (O + Q) * D + o] = 1
            G.append(h[k] * block)
        close = {"rtol": 1e-12, "atol": 1e-12}
        assert_close(policy.gating(x).numpy(), h, **close)
        assert_close(policy.basis(x).numpy(), np.hstack(G), **close)
        assert_close(policy.A.detach().numpy(), A[:, :O], **close)
        assert_close(policy.b.detach().numpy(), b[:, :O], **close)
        assert_close(policy(x).detach().numpy(), y[:O], **close)
        assert_close(policy.stiffness(x).detach().numpy(), y[O:], **close)
        assert_close(policy.features(x).numpy(), np.outer(h, [*x, 1]).ravel(), **close)


def test_stiffness_without_a_batch_is_that_of_every_policy_of_it(random_mixture, randn):
    mixture = random_mixture(K=2, F=4, batch=(3,))
    policy = GMRPolicy.from_mixture(mixture, 2, stiffness_dim=1, stiffness=100.0)
    assert policy.stiffness_b.shape == (3, 2, 1) and policy.batch_shape == (3,)
    x = randn(3, 2)
    together = policy.stiffness(x)
    for i in range(3):
        assert_close(policy[i].stiffness(x[i]), together[i])
    assert policy[0].expand(5).stiffness_b.shape == (5, 2, 1)
    values = {name: getattr(policy[0], name) for name in ("priors", "means", "covariances")}
    with pytest.raises(InvalidArgumentError, match=r"one batch, got \(3,\) and \(4,\)"):
        GMRPolicy(
            A=randn(3, 2, 2, 2), b=randn(3, 2, 2), stiffness_A=randn(4, 2, 1, 2), stiffness_b=randn(4, 2, 1), **values
        )


def test_one_component_is_linear(random_policy, randn):
    policy, x = random_policy(K=1), 100 * randn(50, 2)
    assert torch.equal(policy.gating(x), torch.ones(50, 1, dtype=x.dtype))
    assert_close(policy(x), x @ policy.A[0].T + policy.b[0], rtol=1e-12, atol=1e-12)


def test_gating_sums_to_one(random_policy, randn):
    h = random_policy(K=5).gating(3 * randn(100, 2))
    assert (h >= 0).all()
    assert_close(h.sum(-1), torch.ones(100, dtype=h.dtype), rtol=0, atol=1e-14)


def test_the_policy_is_the_conditional_mean_of_its_mixture(random_mixture, randn):
    mixture, x = random_mixture(K=3, F=5), randn(4, 6, 2)
    assert_close(GMRPolicy.from_mixture(mixture, 2)(x), mixture.condition(x).mean, rtol=1e-12, atol=1e-12)


def test_a_constant_stiffness_has_no_slope(random_mixture, randn):
    mixture, x = random_mixture(), randn(7, 2)
    alone = GMRPolicy.from_mixture(mixture, 2)
    for stiffness in (20.0, torch.tensor([10.0, 30.0], dtype=torch.float64)):
        policy = GMRPolicy.from_mixture(mixture, 2, stiffness_dim=2, stiffness=stiffness)
        expected = torch.as_tensor(stiffness, dtype=torch.float64).expand(7, 2)
        assert_close(policy.stiffness(x), expected, rtol=1e-14, atol=0)
        assert not policy.stiffness_A.any()
        assert_close(policy(x), alone(x), rtol=1e-14, atol=1e-14)
    assert alone.stiffness(x).shape == (7, 0)


def test_covariances_are_those_of_the_inputs(random_mixture):
    mixture = random_mixture(K=4, F=6)
    policy = GMRPolicy.from_mixture(mixture, 3)
    assert_close(policy.covariances, mixture.covariances[:, :3, :3], rtol=1e-12, atol=1e-12)


def test_the_field_differentiates(random_policy, randn):
    policy, x = random_policy(K=2, Q=1, batch=(2,)), randn(2, 3, 2).requires_grad_()
    A, b = policy.A.detach().clone().requires_grad_(), policy.b.detach().clone().requires_grad_()
    torch.autograd.gradcheck(lambda x, A, b: functional_call(policy, {"A": A, "b": b}, (x,)), (x, A, b))
    torch.autograd.gradcheck(policy.gating, (x,))
    torch.autograd.gradcheck(policy.stiffness, (x,))


@sizes
@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize("points", [(), (3,), (3, 2)])
def test_the_jacobian_is_that_of_autograd(random_policy, randn, size, batch, points):
    policy, x = random_policy(**size, batch=batch), randn(*batch, *points, size["D"]).requires_grad_()
    y = torch.cat([policy(x), policy.stiffness(x)], -1)
    rows = [torch.autograd.grad(y_o.sum(), x, retain_graph=True)[0] for y_o in y.unbind(-1)]
    assert_close(policy.jacobian(x), torch.stack(rows, -2), rtol=1e-11, atol=1e-11)


# ---------------------------------------------------------------------- far from the data


def exact_gating(priors, means, covariances, x):
    """Eq. 2 in the plane with rational distances, so that nothing is lost however large they are."""
    logs = []
    for pi, mu, Sigma in zip(priors.tolist(), means.tolist(), covariances.tolist(), strict=True):
        dx, dy = (Fraction(a) - Fraction(m) for a, m in zip(x.tolist(), mu, strict=True))
        (a, b), (_, d) = [[Fraction(s) for s in row] for row in Sigma]
        det = a * d - b * b
        logs.append((d * dx * dx - 2 * b * dx * dy + a * dy * dy) / det / -2 + Fraction(math.log(pi / det**0.5)))
    weights = [math.exp(max(log - max(logs), Fraction(-1000))) for log in logs]
    return torch.tensor(weights, dtype=torch.float64) / sum(weights)


@pytest.mark.parametrize("equal_covariances", [False, True])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("distance", [1.0, 10.0, 1e3, 1e6])
def test_gating_is_right_a_million_standard_deviations_away(random_mixture, dtype, distance, equal_covariances):
    gate = random_mixture(K=4, F=2)
    Sigma = gate.covariances[:1].expand(4, 2, 2) if equal_covariances else gate.covariances
    A, b = torch.zeros(4, 1, 2, dtype=dtype), torch.zeros(4, 1, dtype=dtype)
    policy = GMRPolicy(gate.priors.to(dtype), gate.means.to(dtype), Sigma.to(dtype), A, b)
    angle = torch.arange(16, dtype=torch.float64) * torch.pi / 8 + 0.1
    x = (distance * torch.stack([angle.cos(), angle.sin()], -1)).to(dtype)
    h = policy.gating(x)
    # rounding moves log h by the square of the distance times eps, unless one component takes all
    tolerance = {torch.float64: 1e-9, torch.float32: 1e-4}[dtype]
    expected = torch.stack([exact_gating(gate.priors, gate.means, Sigma, x_i) for x_i in x])
    assert_close(h.double(), expected, rtol=0, atol=tolerance)
    assert_close(h.sum(-1), torch.ones(16, dtype=dtype), rtol=0, atol=1e-6)
    assert torch.equal(h.argmax(-1), expected.argmax(-1))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("distance", [1e12, 1e18, 1e30])
def test_gating_stays_finite_at_any_distance(random_policy, dtype, distance):
    policy = random_policy(K=4, O=3, Q=2).to(dtype)
    x = distance * torch.tensor([[1.0, 0], [0, 1], [-1, 1], [-1, -1]], dtype=dtype)
    h = policy.gating(x)
    assert_close(h.sum(-1), torch.ones(4, dtype=dtype), rtol=0, atol=1e-6)
    assert policy(x).isfinite().all()
    assert policy.stiffness(x).isfinite().all()


def test_gating_keeps_its_digits_when_all_data_are_far_from_the_origin(random_mixture, randn):
    gate, x = random_mixture(K=3, F=2), randn(20, 2).float()
    A, b = torch.zeros(3, 1, 2), torch.zeros(3, 1)
    shift = torch.tensor([4096.0, -8192.0])  # adding it costs float32 ten binary digits of x and means, but no more
    near = GMRPolicy(gate.priors.float(), gate.means.float(), gate.covariances.float(), A, b)
    far = GMRPolicy(gate.priors.float(), gate.means.float() + shift, gate.covariances.float(), A, b)
    assert_close(far.gating(x + shift), near.gating(x), rtol=0, atol=5e-3)


# ---------------------------------------------------------------------- theta, Eq. 10-11, 44-45


def counted(shape, start):
    return torch.arange(start, start + math.prod(shape), dtype=torch.float64).reshape(shape)


def test_theta_is_ordered_as_in_equation_11():
    A, b = counted((2, 2, 2), 0), counted((2, 2), 100)
    gate = torch.ones(2) / 2, torch.zeros(2, 2), torch.eye(2).expand(2, 2, 2)
    policy = GMRPolicy(*(value.double() for value in gate), A, b)
    assert policy.pack().tolist() == [0, 1, 2, 3, 100, 101, 4, 5, 6, 7, 102, 103]
    assert policy.rows().tolist() == [[0, 1, 100, 4, 5, 102], [2, 3, 101, 6, 7, 103]]


def test_theta_with_one_stiffness_is_ordered_as_in_equation_45():
    A, b, stiffness_A, stiffness_b = (
        counted((2, 2, 2), 0),
        counted((2, 2), 100),
        counted((2, 1, 2), 20),
        counted((2, 1), 200),
    )
    gate = torch.ones(2) / 2, torch.zeros(2, 2), torch.eye(2).expand(2, 2, 2)
    policy = GMRPolicy(*(value.double() for value in gate), A, b, stiffness_A, stiffness_b)
    assert policy.pack().tolist() == [0, 1, 2, 3, 20, 21, 100, 101, 200, 4, 5, 6, 7, 22, 23, 102, 103, 201]
    assert policy.rows().tolist() == [[0, 1, 100, 4, 5, 102], [2, 3, 101, 6, 7, 103], [20, 21, 200, 22, 23, 201]]
    doubled = policy.rows(lambda parameter: 2 * parameter.detach())
    assert torch.equal(doubled, 2 * policy.rows())


@sizes
@pytest.mark.parametrize("points", [(), (4,), (4, 3)])
def test_basis_times_theta_is_velocity_and_stiffness(random_policy, randn, size, points):
    policy, x = random_policy(**size, moved=True), randn(*points, size["D"])
    y = torch.cat([policy(x), policy.stiffness(x)], -1)
    assert_close(policy.basis(x) @ policy.pack(), y, rtol=1e-12, atol=1e-12)
    assert_close(policy.features(x) @ policy.rows().T, y, rtol=1e-12, atol=1e-12)


@sizes
@pytest.mark.parametrize("batch", [(), (5,), (5, 3)])
def test_unpacked_theta_is_packed_again(random_policy, randn, size, batch):
    policy = random_policy(**size)
    parameters = dict(policy.named_parameters())
    theta = randn(*batch, policy.pack().shape[-1])
    assert policy.unpack(theta) is policy
    assert torch.equal(policy.pack(), theta)
    assert policy.batch_shape == batch
    # an optimizer that holds the parameters sees the new values
    assert all(value is parameters[name] for name, value in policy.named_parameters())
    theta.zero_()
    assert policy.pack().any()


def test_unpack_to_another_batch_forgets_the_gradient(random_policy, randn):
    policy, x = random_policy(), randn(2)
    policy(x).sum().backward()
    before = policy.A.grad.clone()
    policy.unpack(policy.pack())
    assert torch.equal(policy.A.grad, before)
    policy.unpack(policy.pack().expand(3, -1))
    policy(x).sum().backward()
    assert_close(policy.A.grad, before.expand(3, 3, 2, 2), rtol=1e-12, atol=1e-12)


def test_split_is_differentiable_and_changes_nothing(random_policy, randn):
    policy = random_policy(Q=1)
    before = policy.pack().detach().clone()
    theta = randn(4, len(before)).requires_grad_()
    named = policy.split(theta)
    assert {name: tuple(value.shape) for name, value in named.items()} == {
        name: (4, *value.shape) for name, value in policy.named_parameters()
    }
    sum(value.square().sum() for value in named.values()).backward()
    assert_close(theta.grad, 2 * theta.detach(), rtol=1e-15, atol=0)
    assert torch.equal(policy.pack(), before)


def test_initial_rows_stay_those_of_the_demonstrations(random_policy, randn):
    policy = random_policy(Q=1)
    before = policy.rows().detach().clone()
    policy.unpack(randn(*policy.pack().shape))
    assert torch.equal(policy.initial_rows, before)
    assert not torch.equal(policy.rows(), before)
    assert torch.equal(policy.expand(3).initial_rows, before)


# ---------------------------------------------------------------------- batches


def singles(policy):
    """The policies of a batch, one by one."""
    for theta in policy.pack().detach().flatten(0, -2):
        yield copy.deepcopy(policy).unpack(theta)


@sizes
@pytest.mark.parametrize("batch", [(4,), (2, 3)])
@pytest.mark.parametrize("points", [(), (5,), (5, 2)])
def test_a_batch_of_policies_equals_a_loop(random_policy, randn, size, batch, points):
    policy, x = random_policy(**size, batch=batch), randn(*batch, *points, size["D"])
    velocity, stiffness = policy(x).flatten(0, len(batch) - 1), policy.stiffness(x).flatten(0, len(batch) - 1)
    for i, (single, x_i) in enumerate(zip(singles(policy), x.flatten(0, len(batch) - 1), strict=True)):
        expected = torch.stack([single(p) for p in x_i.reshape(-1, size["D"])]).reshape(*points, -1)
        assert_close(velocity[i], expected, rtol=1e-12, atol=1e-12)
        assert_close(stiffness[i], single.stiffness(x_i), rtol=1e-12, atol=1e-12)
        assert_close(policy.gating(x).flatten(0, len(batch) - 1)[i], single.gating(x_i), rtol=1e-12, atol=1e-12)


def test_a_batch_equals_vmap_over_single_policies(random_policy, randn):
    batch, x = random_policy(Q=1, batch=(6,)), randn(6, 3, 2)
    models = list(singles(batch))
    parameters, buffers = stack_module_state(models)
    y = vmap(lambda p, b, x: functional_call(models[0], (p, b), (x,)))(parameters, buffers, x)
    assert_close(batch(x), y, rtol=1e-12, atol=1e-12)


def test_parameters_without_a_batch_are_shared_by_those_that_have_one(random_policy, randn):
    policy, x = random_policy(Q=1), randn(5, 4, 2)
    initial = {name: value.detach().clone() for name, value in policy.named_parameters()}
    for name in initial:  # an optimizer of this parameter alone
        mixed = copy.deepcopy(policy)
        mixed.get_parameter(name).data = randn(5, *initial[name].shape)
        full = policy.expand(5)
        full.get_parameter(name).data = mixed.get_parameter(name).data
        assert mixed.batch_shape == (5,)
        for function in (GMRPolicy.forward, GMRPolicy.stiffness, GMRPolicy.jacobian):
            assert_close(function(mixed, x), function(full, x), rtol=1e-12, atol=1e-12)
        assert torch.equal(mixed.pack(), full.pack())
        assert torch.equal(mixed.rows(), full.rows())


def test_expand_copies_a_policy(random_policy, randn):
    policy, x = random_policy(Q=2, moved=True), randn(2)
    copies = policy.expand(5, 3)
    assert copies.batch_shape == (5, 3)
    assert torch.equal(copies.gating(x), policy.gating(x))
    assert_close(copies(x), policy(x).expand(5, 3, 2), rtol=1e-14, atol=1e-14)
    with torch.no_grad():
        copies.b[0, 0] += 1.0
    assert_close(copies(x)[0, 0], policy(x) + 1, rtol=1e-14, atol=1e-14)
    assert_close(copies(x)[0, 1], policy(x), rtol=1e-14, atol=1e-14)  # the copies are independent


def test_indexing_selects_policies_of_the_batch(random_policy, randn):
    policy, x = random_policy(Q=1, batch=(4, 2)), randn(2)
    assert torch.equal(policy[1].pack(), policy.pack()[1])
    assert torch.equal(policy[1:3].pack(), policy.pack()[1:3])
    chosen = torch.tensor([3, 0, 3])
    assert torch.equal(policy[chosen].pack(), policy.pack()[chosen])
    assert_close(policy[1][0](x), policy(x)[1, 0], rtol=1e-12, atol=1e-12)
    policy[1].unpack(torch.zeros_like(policy[1].pack()))
    assert policy.pack()[1].any()  # the part is a copy
    with pytest.raises(InvalidArgumentError, match=r"no batch to index; make one with expand\(n\)"):
        policy[1][0][0]


# ---------------------------------------------------------------------- a good nn.Module


@pytest.mark.parametrize("Q", [0, 2])
def test_state_dict_round_trips_exactly(random_policy, randn, tmp_path, Q):
    policy, other = random_policy(Q=Q, moved=True), random_policy(Q=Q)
    assert not torch.equal(policy.pack(), other.pack())
    torch.save(policy.state_dict(), tmp_path / "policy.pt")
    state = torch.load(tmp_path / "policy.pt", weights_only=True)
    assert {"priors", "means", "factors", "initial_A", "initial_b", "A", "b"} <= set(state)
    other.load_state_dict(state)
    x = randn(9, 2)
    assert torch.equal(other.pack(), policy.pack())
    assert torch.equal(other(x), policy(x))
    assert torch.equal(other.initial_rows, policy.initial_rows)


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda policy: pickle.loads(pickle.dumps(policy))])
def test_copies_are_equal_and_independent(random_policy, randn, clone):
    policy, x = random_policy(Q=1, batch=(3,)), randn(3, 4, 2)
    twin = clone(policy)
    assert torch.equal(twin(x), policy(x))
    assert torch.equal(twin.stiffness(x), policy.stiffness(x))
    twin.unpack(torch.zeros_like(twin.pack()))
    assert policy.pack().any()


@sizes
def test_float32_gives_the_same_field_to_its_precision(random_policy, randn, size):
    policy, x = random_policy(**size, batch=(2,)), randn(2, 4, size["D"])
    single = copy.deepcopy(policy).to(torch.float32)
    for function in ("__call__", "gating", "stiffness", "basis", "features"):
        y = getattr(single, function)(x.float())
        assert y.dtype == torch.float32
        assert_close(y.double(), getattr(policy, function)(x), rtol=1e-4, atol=1e-4)
    assert single.covariances.dtype == torch.float32
    assert single.unpack(policy.pack()).A.dtype == torch.float32


def test_only_the_experts_are_learnable(random_policy):
    assert [name for name, _ in random_policy().named_parameters()] == ["A", "b"]
    names = [name for name, _ in random_policy(Q=1).named_parameters()]
    assert names == ["A", "b", "stiffness_A", "stiffness_b"]


@pytest.mark.slow
@pytest.mark.no_cover
@pytest.mark.parametrize("batch", [(), (3,)])
def test_the_compiled_policy_equals_the_eager_one(random_policy, randn, batch):
    policy, x = random_policy(Q=1, batch=batch), randn(*batch, 5, 2).requires_grad_()
    compiled = torch.compile(policy, backend="aot_eager", fullgraph=True)
    assert_close(compiled(x), policy(x), rtol=1e-14, atol=1e-14)
    (gradient,) = torch.autograd.grad(compiled(x).square().sum(), x)
    (expected,) = torch.autograd.grad(policy(x).square().sum(), x)
    assert_close(gradient, expected, rtol=1e-12, atol=1e-12)
    policy.unpack(torch.zeros_like(policy.pack()))
    assert not compiled(x).any()


def test_functional_call_replaces_the_parameters(random_policy, randn):
    policy, x = random_policy(), randn(4, 2)
    theta = randn(*policy.pack().shape)
    y = functional_call(policy, policy.split(theta), (x,))
    assert not torch.equal(y, policy(x))
    assert_close(y, policy.unpack(theta)(x), rtol=0, atol=0)


def test_the_summary_names_the_sizes(random_policy):
    assert repr(random_policy(K=3, D=2, O=3, Q=1, batch=(4,))) == "GMRPolicy(K=3, D=2, O=3, Q=1, batch_shape=(4,))"


# ---------------------------------------------------------------------- from demonstrations


@pytest.mark.slow
def test_demonstrations_are_fitted_and_conditioned(randn):
    x, v, s = [randn(40, 2)], [randn(40, 2)], [randn(40, 1)]
    demos = Demonstrations(x, dt=0.1, v=v, stiffness=s)
    samples = torch.cat([x[0], v[0], s[0]], -1)
    options = {"covariance_floor": 1e-6, "tol": 1e-2, "seed": 1}  # None is relative to what each column is
    expected = GMRPolicy.from_mixture(GaussianMixture.fit(samples, 2, **options), 2, stiffness_dim=1)
    policy = GMRPolicy.from_demonstrations(demos, 2, **options)
    assert policy.stiffness_dim == 1
    assert torch.equal(policy.pack(), expected.pack())
    # one component is linear regression
    linear = GMRPolicy.from_demonstrations(demos, 1, covariance_floor=1e-12)
    with_one = torch.cat([x[0], torch.ones(40, 1, dtype=torch.float64)], -1)
    solution = torch.linalg.lstsq(with_one, samples[:, 2:]).solution.T
    assert_close(linear.rows().detach(), solution, rtol=1e-9, atol=1e-9)


def test_inputs_may_be_fewer_than_the_demonstrated_positions(randn):
    demos = Demonstrations([randn(40, 3)], dt=0.1)
    policy = GMRPolicy.from_demonstrations(demos, 1, input_dim=2, stiffness=150.0, stiffness_dim=1)
    assert (policy.input_dim, policy.output_dim, policy.stiffness_dim) == (2, 3, 1)
    with pytest.raises(InvalidArgumentError, match="input_dim has to be between 1 and the 3 positions, got 4"):
        GMRPolicy.from_demonstrations(demos, 2, input_dim=4)


def test_stiffness_is_either_demonstrated_or_constant(randn):
    bare = Demonstrations([randn(40, 2)], dt=0.1)
    with pytest.raises(InvalidArgumentError, match="carry no stiffness; stiffness_dim=1 needs stiffness=s0 too"):
        GMRPolicy.from_demonstrations(bare, 1, stiffness_dim=1)
    stiff = Demonstrations([randn(40, 2)], dt=0.1, stiffness=[randn(40, 1)])
    with pytest.raises(InvalidArgumentError, match=r"carry stiffness; leave out stiffness=20\.0"):
        GMRPolicy.from_demonstrations(stiff, 1, stiffness=20.0, stiffness_dim=1)


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": torch.zeros(2, 2)}, "slopes have to be (*batch, 3, O, 2) and offsets (*batch, 3, O); got (2, 2)"),
        ({"A": torch.zeros(3, 2, 3)}, "got (3, 2, 3) and (3, 2)"),
        ({"A": torch.zeros(4, 2, 2)}, "got (4, 2, 2) and (3, 2)"),
        ({"b": torch.zeros(3, 3)}, "got (3, 2, 2) and (3, 3)"),
        ({"b": torch.zeros(5, 3, 2)}, "got (3, 2, 2) and (5, 3, 2)"),
        ({"stiffness_A": torch.zeros(3, 1, 3), "stiffness_b": torch.zeros(3, 1)}, "got (3, 1, 3) and (3, 1)"),
        ({"stiffness_A": torch.zeros(3, 1, 2)}, "stiffness_A and stiffness_b come together"),
        ({"stiffness_b": torch.zeros(3, 1)}, "stiffness_A and stiffness_b come together"),
        (
            {
                "priors": torch.ones(5, 3) / 3,
                "means": torch.zeros(5, 3, 2),
                "covariances": torch.eye(2).expand(5, 3, 2, 2),
            },
            "a gating of batch (5,) needs parameters whose batch ends with it, got ()",
        ),
    ],
)
def test_shapes_that_do_not_fit_are_refused(change, message):
    gate = {"priors": torch.ones(3) / 3, "means": torch.zeros(3, 2), "covariances": torch.eye(2).expand(3, 2, 2)}
    valid = gate | {"A": torch.zeros(3, 2, 2), "b": torch.zeros(3, 2)}
    GMRPolicy(**valid)
    with pytest.raises(InvalidArgumentError, match=re.escape(message)):
        GMRPolicy(**valid | change)


def test_a_gating_that_is_no_mixture_is_refused():
    with pytest.raises(DegenerateMixtureError, match="have to be symmetric positive definite"):
        GMRPolicy(torch.ones(1), torch.zeros(1, 2), -torch.eye(2)[None], torch.zeros(1, 2, 2), torch.zeros(1, 2))


@pytest.mark.parametrize(
    ("dimensions", "message"),
    [
        (
            {"input_dim": 4},
            "a mixture of 4 variables cannot give input_dim=4, stiffness_dim=0 and at least one velocity",
        ),
        ({"input_dim": 2, "stiffness_dim": 2}, "pass stiffness=s0 for a constant stiffness"),
        ({"input_dim": 2, "stiffness_dim": -1}, "cannot give input_dim=2, stiffness_dim=-1"),
        ({"input_dim": 0}, "input_dim has to be between 1 and 3 for 4 variables, got 0"),
        ({"input_dim": 2, "stiffness": 20.0}, "stiffness=20.0 needs stiffness_dim ≥ 1, got 0"),
        (
            {"input_dim": 2, "stiffness": torch.ones(3), "stiffness_dim": 2},
            "stiffness has to be a number or (2,) for stiffness_dim=2 and fit (2,), got shape (3,)",
        ),
    ],
)
def test_dimensions_that_a_mixture_does_not_have_are_refused(random_mixture, dimensions, message):
    with pytest.raises(InvalidArgumentError, match=re.escape(message)):
        GMRPolicy.from_mixture(random_mixture(F=4), **dimensions)


@pytest.mark.parametrize("shape", [(17,), (4, 19), (18, 1), ()])
def test_theta_of_the_wrong_size_is_refused(random_policy, shape):
    policy = random_policy()
    with pytest.raises(
        InvalidArgumentError, match=re.escape(f"theta has to be (*batch, 18) for this policy, got {shape}")
    ):
        policy.unpack(torch.zeros(shape))


@pytest.mark.slow
def test_policies_over_different_gatings_equal_single_ones(randn):
    B, K, D = 4, 3, 2
    L = 0.3 * randn(B, K, 2 * D, 2 * D) + torch.eye(2 * D, dtype=torch.float64)
    mixture = GaussianMixture(randn(B, K).softmax(-1), randn(B, K, 2 * D), L @ L.mT)
    policy = GMRPolicy.from_mixture(mixture, D)
    runs = policy.expand(5)
    x = randn(5, B, 7, D)
    assert policy.batch_shape == (B,) and runs.batch_shape == (5, B)
    for b in range(B):
        torch.testing.assert_close(policy[b](x[0, b]), policy(x[0])[b], rtol=0, atol=1e-12)
        torch.testing.assert_close(policy[b].jacobian(x[0, b]), policy.jacobian(x[0])[b], rtol=0, atol=1e-12)
        for n in range(5):
            torch.testing.assert_close(policy[b](x[n, b]), runs(x)[n, b], rtol=0, atol=1e-12)
