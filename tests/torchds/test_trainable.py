"""The batch of which all is learned, against torch.distributions and eigenvalues, one fit and one Gaussian at a time."""

import pytest
import torch
from torch.distributions import MultivariateNormal
from torch.testing import assert_close

from torchds.mixture import GaussianMixture
from torchds.trainable import TrainableMixture

FLOOR, MARGIN = 1e-3, 0.1


@pytest.fixture
def metric(randn):
    """Two positive definite matrices of trace 2."""
    root = randn(2, 2, 2)
    P = root @ root.mT + 0.5 * torch.eye(2, dtype=torch.float64)
    return 2 * P / P.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None]


@pytest.fixture
def start(random_mixture):
    """Two mixtures of three Gaussians, the second of them with padding."""
    mixture = random_mixture(K=3, F=4, batch=(2,))
    priors = torch.stack([mixture.priors[0], torch.tensor([0.3, 0.7, 0.0], dtype=torch.float64)])
    return GaussianMixture(priors, mixture.means, mixture.covariances)


def moved(model, randn):
    """The model after its parameters were changed at random."""
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.2 * randn(*parameter.shape)
    return model


def largest_rate(A, P):
    """The largest eigenvalue of the symmetric part of C A C⁻¹ with P = CᵀC."""
    C = torch.linalg.cholesky(P).mT
    seen = C @ A @ torch.linalg.inv(C)
    return torch.linalg.eigvalsh(seen + seen.T)[-1] / 2


def test_the_start_is_the_mixture_with_a_floor(start, randn):
    A = randn(2, 3, 2, 2)
    model, ridge = TrainableMixture(start, A, margin=MARGIN, floor=FLOOR), FLOOR * torch.eye(2, dtype=torch.float64)
    assert_close(model.priors, start.priors)
    assert_close(model.mean, start.means[..., :2])
    assert_close(model.covariances, start.covariances[..., :2, :2] + ridge)
    assert_close(model.A, A)
    assert model.P is None and not model.slowness(*model.slopes_and_metric(), 10.0).any()


def test_velocity_and_likelihood_are_sums_over_gaussians(start, randn):
    A, x, v = randn(2, 3, 2, 2), randn(2, 7, 2), randn(2, 7, 2)
    model, ridge = TrainableMixture(start, A, margin=MARGIN, floor=FLOOR), FLOOR * torch.eye(2, dtype=torch.float64)
    noise = start.condition(x[:, 0]).covariances + ridge  # of the velocity once the position is known
    for b in range(2):
        log_joint, velocity, weight = [], torch.zeros(7, 2, dtype=torch.float64), torch.zeros(7, 1, dtype=torch.float64)
        for k in range(3 - b):  # the second has two Gaussians
            gate = MultivariateNormal(start.means[b, k, :2], start.covariances[b, k, :2, :2] + ridge)
            density = start.priors[b, k] * gate.log_prob(x[b]).exp().unsqueeze(-1)
            velocity, weight = velocity + density * (x[b] @ A[b, k].T), weight + density
            error = MultivariateNormal(x[b] @ A[b, k].T, noise[b, k])
            log_joint.append(density.squeeze(-1).log() + error.log_prob(v[b]))
        assert_close(model(x, model.A)[b], velocity / weight)
        expected, got = torch.stack(log_joint).logsumexp(0), model.log_likelihood(x, v, model.A)[b]
        assert_close(got - got[0], expected - expected[0])  # up to a constant


@pytest.mark.parametrize("learn_metric", [False, True])
def test_slopes_are_stable_wherever_the_parameters_go(start, metric, randn, learn_metric):
    model = TrainableMixture(start, randn(2, 3, 2, 2), metric, margin=MARGIN, learn_metric=learn_metric)
    assert_close(model.P, metric)
    moved(model, randn)
    assert model.P.equal(metric) is not learn_metric
    assert_close(model.P.diagonal(dim1=-2, dim2=-1).sum(-1), torch.full((2,), 2.0, dtype=torch.float64))
    rates = torch.stack([torch.stack([largest_rate(A, model.P[b]) for A in model.A[b]]) for b in range(2)])
    assert (torch.linalg.eigvalsh(model.P) > 0).all() and (rates < -MARGIN).all()
    wanted = 3.0  # faster than some of them are
    short = (wanted + rates).clamp(min=0).square()
    assert_close(
        model.slowness(*model.slopes_and_metric(), wanted), torch.stack([short[0].mean(), short[1, :2].mean()])
    )


def test_slopes_that_are_stable_are_where_the_fit_starts(start, metric):
    A = -2 * torch.eye(2, dtype=torch.float64).expand(2, 3, 2, 2)
    assert_close(TrainableMixture(start, A, metric, margin=MARGIN).A, A)


def test_padding_takes_no_part_and_learns_nothing(start, metric, randn):
    x, v, A = randn(2, 7, 2), randn(2, 7, 2), randn(2, 3, 2, 2)
    both = TrainableMixture(start, A, metric, margin=MARGIN)
    short = GaussianMixture(start.priors[1:, :2], start.means[1:, :2], start.covariances[1:, :2])
    alone = TrainableMixture(short, A[1:, :2], metric[1:], margin=MARGIN)
    assert_close(both(x, both.A)[1:], alone(x[1:], alone.A))
    assert_close(both.log_likelihood(x, v, both.A)[1:], alone.log_likelihood(x[1:], v[1:], alone.A))
    (both(x, both.A).square().sum() + both.log_likelihood(x, v, both.A).sum()).backward()
    for name, parameter in both.named_parameters():
        assert parameter.grad[0].any() and not parameter.grad[1, 2].any(), name


@pytest.mark.slow
def test_gradients_are_those_of_finite_differences(start, metric, randn):
    x, v = randn(2, 4, 2), randn(2, 4, 2)
    model = TrainableMixture(start, randn(2, 3, 2, 2), metric, margin=MARGIN, learn_metric=True)
    parameters = dict(model.named_parameters())

    def loss(*values):
        state = dict(zip(parameters, values, strict=True))
        call = lambda x, v: (model(x, model.A) - v).square().sum() - model.log_likelihood(x, v, model.A).sum()  # noqa: E731
        return torch.func.functional_call(Called(model, call), {f"model.{k}": p for k, p in state.items()}, (x, v))

    free = tuple(p.detach().clone().requires_grad_() for name, p in parameters.items() if name != "log_prior")
    names = [name for name in parameters if name != "log_prior"]  # that of padding is −10⁹
    fixed = parameters["log_prior"].detach()

    def of_free(*values):
        state = dict(zip(names, values, strict=True)) | {"log_prior": fixed}
        return loss(*(state[name] for name in parameters))

    assert torch.autograd.gradcheck(of_free, free, atol=1e-6)


class Called(torch.nn.Module):
    """A function of a module as a module, for functional_call."""

    def __init__(self, model, call):
        super().__init__()
        self.model, self.call = model, call

    def forward(self, x, v):
        return self.call(x, v)
