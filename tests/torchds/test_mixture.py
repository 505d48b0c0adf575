import re

import numpy as np
import pytest
import scipy.special
import scipy.stats
import sklearn.mixture
import torch
from torch.testing import assert_close

from tests.recorded import write_absurd_npz
from torchds import Demonstrations, GaussianMixture, GMRPolicy, load_lasa
from torchds.errors import (
    DegenerateMixtureError,
    DemonstrationWarning,
    FileError,
    InvalidArgumentError,
    LargestMixtureWarning,
)

AXIS = np.linspace(-25, 25, 1001)  # sums over it integrate Gaussians of unit scale to rounding errors
STEP = AXIS[1] - AXIS[0]


def test_log_prob_is_that_of_scipy(random_mixture, randn):
    mixture, y = random_mixture(K=3, F=4), 2 * randn(7, 4)
    normals = zip(mixture.means.numpy(), mixture.covariances.numpy(), strict=True)
    each = np.stack([scipy.stats.multivariate_normal(mu, Sigma).logpdf(y.numpy()) for mu, Sigma in normals], -1)
    each += np.log(mixture.priors.numpy())
    assert_close(mixture.component_log_prob(y).numpy(), each, rtol=1e-12, atol=1e-12)
    assert_close(mixture.log_prob(y).numpy(), scipy.special.logsumexp(each, -1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("start", "stop"), [(0, 1), (1, 2)])
def test_a_marginal_is_the_integral_over_the_other_variable(random_mixture, randn, start, stop):
    mixture, y = random_mixture(K=3, F=2), randn(5, 1)
    other = torch.from_numpy(AXIS)[:, None]
    pairs = [y.repeat_interleave(len(AXIS), 0), other.repeat(5, 1)]
    joint = mixture.log_prob(torch.cat(pairs if start == 0 else pairs[::-1], -1)).exp().reshape(5, -1)
    assert_close(mixture.marginal(start, stop).log_prob(y).exp(), joint.sum(-1) * STEP, rtol=1e-10, atol=0)


def test_condition_is_the_joint_density_over_its_integral(random_mixture, randn):
    mixture, x = random_mixture(K=3, F=3), randn(4, 2)
    conditional = mixture.condition(x)
    y = torch.from_numpy(AXIS)[:, None]
    for i in range(4):
        joint = mixture.log_prob(torch.cat([x[i].expand(len(y), 2), y], -1)).exp()  # p(x_i, y) at each y
        density = joint / (joint.sum() * STEP)
        of_y = GaussianMixture(conditional.priors[i], conditional.means[i], conditional.covariances)
        assert_close(of_y.log_prob(y).exp(), density, rtol=1e-9, atol=1e-14)
        assert_close(conditional.mean[i, 0], (y[:, 0] * density).sum() * STEP, rtol=1e-10, atol=1e-10)


def test_condition_on_one_of_three_variables_has_the_integrated_mean(random_mixture, randn):
    mixture, x = random_mixture(K=3, F=3), randn(1)
    axis = torch.linspace(-15, 15, 301, dtype=torch.float64)
    y = torch.cartesian_prod(axis, axis)
    weight = mixture.log_prob(torch.cat([x.expand(len(y), 1), y], -1)).softmax(0)
    assert_close(mixture.condition(x).mean, weight @ y, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("D", [1, 2, 3])
def test_experts_are_the_printed_ones(random_mixture, gmr_as_printed, D):
    mixture = random_mixture(K=3, F=4)
    A, b = mixture.experts(D)
    _, A_printed, b_printed, _ = gmr_as_printed(mixture, np.zeros(D))
    assert_close(A.numpy(), A_printed, rtol=1e-12, atol=1e-12)
    assert_close(b.numpy(), b_printed, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("points", [(), (5,), (5, 2)])
def test_a_batch_of_mixtures_equals_a_loop(random_mixture, randn, points):
    batch = random_mixture(K=3, F=4, batch=(2, 3))
    y = randn(2, 3, *points, 4)
    A, b = batch.experts(2)
    for i in np.ndindex(2, 3):
        single = GaussianMixture(batch.priors[i], batch.means[i], batch.covariances[i])
        assert_close(batch.log_prob(y)[i], single.log_prob(y[i]), rtol=1e-12, atol=1e-12)
        assert_close(batch.marginal(1, 3).log_prob(y[..., 1:3])[i], single.marginal(1, 3).log_prob(y[i][..., 1:3]))
        assert_close((A[i], b[i]), single.experts(2), rtol=1e-12, atol=1e-12)
        part = batch.condition(y[..., :2])
        expected = single.condition(y[i][..., :2])
        assert_close((part.priors[i], part.means[i], part.covariances[i]), tuple(expected), rtol=1e-12, atol=1e-12)
        assert_close(part.mean[i], expected.mean, rtol=1e-12, atol=1e-12)


def test_float32_in_gives_float32_out(random_mixture, randn):
    mixture, y = random_mixture(), randn(5, 4)
    single = GaussianMixture(mixture.priors.float(), mixture.means.float(), mixture.covariances.float())
    assert_close(single.log_prob(y.float()), mixture.log_prob(y).float(), rtol=1e-5, atol=1e-4)
    assert_close(
        single.condition(y[:, :2].float()).mean, mixture.condition(y[:, :2]).mean.float(), rtol=1e-4, atol=1e-4
    )


def test_the_summary_names_the_sizes(random_mixture):
    assert repr(random_mixture(K=2, F=3)) == "GaussianMixture(K=2, F=3)"
    assert repr(random_mixture(K=2, F=3, batch=(5,))) == "GaussianMixture(K=2, F=3, batch_shape=(5,))"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"priors": torch.ones(3) / 3},
            "have to be (*batch, K), (*batch, K, F) and (*batch, K, F, F), got (3,), (2, 2) and",
        ),
        ({"means": torch.zeros(2, 3)}, "and (*batch, K, F, F), got (2,), (2, 3) and (2, 2, 2)"),
        ({"means": torch.zeros(2)}, "got (2,), (2,) and (2, 2, 2)"),
        ({"covariances": torch.eye(2)}, "got (2,), (2, 2) and (2, 2)"),
        ({"means": torch.full((2, 2), torch.nan)}, "means have to be finite, got NaN or infinity"),
        ({"priors": torch.tensor([torch.inf, 0.0])}, "priors have to be finite, got NaN or infinity"),
        ({"covariances": torch.full((2, 2, 2), -torch.inf)}, "covariances have to be finite, got NaN or infinity"),
        ({"priors": torch.tensor([1.5, -0.5])}, "≥ 0 and sum to 1, got [1.5, -0.5]"),
        ({"priors": torch.tensor([0.5, 0.4])}, "≥ 0 and sum to 1"),
        (
            {"covariances": torch.stack([torch.eye(2), -torch.eye(2)])},
            "symmetric positive definite, got others in component(s) [1]; fit",
        ),
        ({"covariances": torch.tensor([[[1.0, 0.5], [0.0, 1.0]]] * 2)}, "definite, got others in component(s) [0, 1]"),
        ({"covariances": torch.zeros(2, 2, 2)}, "add a small multiple of the identity"),
    ],
)
def test_what_is_no_mixture_is_refused(change, message):
    valid = {"priors": torch.ones(2) / 2, "means": torch.zeros(2, 2), "covariances": torch.eye(2).repeat(2, 1, 1)}
    GaussianMixture(**valid)
    with pytest.raises(DegenerateMixtureError, match=re.escape(message)):
        GaussianMixture(**valid | change)


@pytest.mark.parametrize("D", [-1, 0, 4])
def test_experts_need_an_input_and_an_output(random_mixture, D):
    with pytest.raises(InvalidArgumentError, match=f"between 1 and 3 for 4 variables, got {D}"):
        random_mixture(F=4).experts(D)


# ---------------------------------------------------------------------- files


def test_a_saved_mixture_is_loaded_exactly(random_mixture, tmp_path):
    mixture = random_mixture()
    mixture.save(tmp_path / "mixture.npz")
    loaded = GaussianMixture.load(tmp_path / "mixture.npz")
    for name in ("priors", "means", "covariances"):
        assert_close(getattr(loaded, name), getattr(mixture, name), rtol=0, atol=0)


def test_arrays_under_greek_names_are_found(random_mixture, tmp_path):
    mixture = random_mixture()
    arrays = {"gmm_priors": mixture.priors, "gmm_mu": mixture.means, "gmm_sigma": mixture.covariances}
    np.savez(tmp_path / "greek.npz", other=np.ones(3), **{name: value.numpy() for name, value in arrays.items()})
    assert_close(GaussianMixture.load(tmp_path / "greek.npz").covariances, mixture.covariances, rtol=0, atol=0)


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 cut short", b"x1,x2\n0,1\n"])
def test_what_is_no_mixture_file_is_refused(tmp_path, content):
    path = tmp_path / "mixture.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=r"mixture\.npz(: no such file| is no \.npz archive, or a damaged one)"):
        GaussianMixture.load(path)


def test_a_single_array_and_a_file_without_means_are_refused(tmp_path):
    np.save(tmp_path / "array.npy", np.ones(3))
    with pytest.raises(FileError, match=r"array\.npy is no \.npz archive"):
        GaussianMixture.load(tmp_path / "array.npy")
    np.savez(tmp_path / "part.npz", priors=np.ones(1))
    with pytest.raises(
        FileError,
        match=r"part\.npz: a mixture file has to hold priors .*, got one without covariances, means; write it",
    ):
        GaussianMixture.load(tmp_path / "part.npz")


def test_a_file_of_absurd_size_is_refused_before_memory_is_taken(tmp_path):
    write_absurd_npz(tmp_path / "mixture.npz", "means")
    with pytest.raises(FileError, match=r"mixture\.npz has \d+ bytes and claims to unpack to 536870"):
        GaussianMixture.load(tmp_path / "mixture.npz")


def test_what_else_is_in_the_file_is_not_looked_at(random_mixture, tmp_path):
    mixture, path = random_mixture(), tmp_path / "mixture.npz"
    arrays = {name: getattr(mixture, name).numpy() for name in ("priors", "means", "covariances")}
    np.savez(path, **arrays, notes=np.array([{"made by": "me"}], dtype=object))
    assert_close(GaussianMixture.load(path).means, mixture.means, rtol=0, atol=0)


@pytest.mark.parametrize("means", [np.array([["a", "b"]]), np.ones((1, 2), dtype=complex)])
def test_arrays_that_hold_no_real_numbers_are_refused(tmp_path, means):
    np.savez(tmp_path / "mixture.npz", priors=np.ones(1), means=means, covariances=np.eye(2)[None])
    with pytest.raises(FileError, match=r"mixture\.npz: means has to hold real numbers, got"):
        GaussianMixture.load(tmp_path / "mixture.npz")


def test_arrays_that_are_no_mixture_are_refused_with_the_name_of_the_file(tmp_path):
    np.savez(tmp_path / "mixture.npz", priors=np.ones(1), means=np.ones((1, 2)), covariances=-np.eye(2)[None])
    with pytest.raises(
        DegenerateMixtureError, match=r"mixture\.npz: covariances have to be symmetric positive definite"
    ):
        GaussianMixture.load(tmp_path / "mixture.npz")


# ---------------------------------------------------------------------- fit


@pytest.fixture
def clusters(randn):
    """Three clusters of 150 samples in four variables, ten standard deviations apart."""
    centers = torch.tensor([[0.0, 0, 0, 0], [10, 0, 5, 0], [0, 10, 0, 5]], dtype=torch.float64)
    return (centers[:, None] + randn(3, 150, 4)).flatten(0, 1)


def test_a_fit_is_as_likely_as_the_mixture_that_made_the_samples(random_mixture, randn):
    mixture = random_mixture(K=2, F=3)
    means = torch.tensor([[0.0, 0, 0], [4, -4, 4]], dtype=torch.float64)
    truth = GaussianMixture(torch.tensor([0.3, 0.7], dtype=torch.float64), means, mixture.covariances)
    factors = torch.linalg.cholesky(truth.covariances)

    def sample():
        k = (torch.arange(2000) >= 600).long()
        return means[k] + (factors[k] @ randn(2000, 3, 1)).squeeze(-1)

    seen, fresh = sample(), sample()
    likelihood = truth.log_prob(fresh).mean()
    # each of the 19 parameters costs about half a nat in 2000 samples; one Gaussian loses far more
    assert abs(GaussianMixture.fit(seen, 2, tol=1e-4).log_prob(fresh).mean() - likelihood) < 0.02
    assert GaussianMixture.fit(seen, 1).log_prob(fresh).mean() < likelihood - 0.2


@pytest.mark.slow
def test_the_likelihood_of_a_fit_is_the_score_of_scikit_learn(clusters):
    fit = GaussianMixture.fit(clusters, 3, covariance_floor=1e-3, seed=1)
    model = sklearn.mixture.GaussianMixture(3, reg_covar=1e-3, n_init=5, tol=1e-6, max_iter=1000, random_state=1)
    model.fit(clusters.numpy())
    assert_close(fit.log_prob(clusters).mean().item(), model.score(clusters.numpy()), rtol=1e-12, atol=0)
    assert fit.means.dtype == torch.float64


@pytest.mark.slow
def test_bic_counts_well_separated_clusters(clusters):
    assert GaussianMixture.fit(clusters, "bic", max_components=5, tol=1e-3).n_components == 3


@pytest.mark.parametrize("largest", [1, 2])
def test_the_largest_number_that_is_allowed_is_said_where_it_is_the_best(clusters, largest):
    with pytest.warns(
        LargestMixtureWarning, match=f"of 1 to {largest} Gaussians the largest .*; raise max_comp"
    ) as said:
        assert GaussianMixture.fit(clusters, "bic", max_components=largest).n_components == largest
    assert said[0].filename == __file__


@pytest.mark.slow
def test_bic_charges_each_free_number_the_logarithm_of_the_samples(randn):
    y, F, M = randn(30, 2), 2, 30
    fits = {K: GaussianMixture.fit(y, K) for K in (1, 2, 3, 4)}
    free = {K: (K - 1) + K * F + K * F * (F + 1) / 2 for K in fits}
    criterion = {K: free[K] * np.log(M) - 2 * fits[K].log_prob(y).sum().item() for K in fits}
    cheaper = {K: free[K] * 2 - 2 * fits[K].log_prob(y).sum().item() for K in fits}  # Akaike's
    chosen = GaussianMixture.fit(y, "bic", max_components=4).n_components
    assert chosen == min(criterion, key=criterion.get)
    assert chosen != min(cheaper, key=cheaper.get)


@pytest.mark.slow
def test_bic_passes_over_numbers_of_components_that_do_not_fit(clusters, monkeypatch):
    fit = sklearn.mixture.GaussianMixture.fit
    singular = {1, 3, 4}

    def refuse(model, y):
        if model.n_components in singular:
            raise ValueError("ill-defined empirical covariance")
        return fit(model, y)

    monkeypatch.setattr(sklearn.mixture.GaussianMixture, "fit", refuse)
    with pytest.raises(DegenerateMixtureError, match="no mixture of 3 Gaussians fits these 450 samples"):
        GaussianMixture.fit(clusters, 3)
    assert GaussianMixture.fit(clusters, "bic", max_components=4).n_components == 2
    singular |= {2}
    with pytest.raises(DegenerateMixtureError, match="no mixture of 4 Gaussians fits these 450 samples"):
        GaussianMixture.fit(clusters, "bic", max_components=4)


def test_one_seed_gives_one_fit(clusters):
    first, second = (GaussianMixture.fit(clusters, 4, n_init=1, tol=1e-2, seed=3) for _ in range(2))
    other = GaussianMixture.fit(clusters, 4, n_init=1, tol=1e-2, seed=4)
    assert_close((first.priors, first.means), (second.priors, second.means), rtol=0, atol=0)
    assert not torch.equal(first.means, other.means)


def test_a_fit_leaves_the_global_generators_alone(clusters):
    before = np.random.get_state()[1].copy(), torch.get_rng_state()
    GaussianMixture.fit(clusters, 2, n_init=1)
    assert (np.random.get_state()[1] == before[0]).all()
    assert torch.equal(torch.get_rng_state(), before[1])


def test_one_gaussian_has_the_mean_and_the_covariance_of_the_samples_plus_the_floor(clusters):
    fit = GaussianMixture.fit(clusters, 1, covariance_floor=0.5)
    assert_close(fit.means[0], clusters.mean(0), rtol=1e-12, atol=1e-12)
    expected = torch.cov(clusters.T, correction=0) + 0.5 * torch.eye(4, dtype=torch.float64)
    assert_close(fit.covariances[0], expected, rtol=1e-12, atol=1e-12)


def test_demonstrations_are_fitted_over_position_velocity_and_stiffness(randn):
    x, v, s = [randn(20, 2), randn(30, 2)], [randn(20, 2), randn(30, 2)], [randn(20, 1), randn(30, 1)]
    demos = Demonstrations(x, dt=0.1, v=v, stiffness=s)
    mean = torch.cat([torch.cat(x), torch.cat(v), torch.cat(s)], -1).mean(0)
    assert_close(GaussianMixture.fit(demos, 1).means[0], mean, rtol=1e-12, atol=1e-12)
    # Eq. 36: the angle is no input, its velocity is an output
    assert_close(GaussianMixture.fit(demos, 1, input_dim=1).means[0], mean[[0, 2, 3, 4]], rtol=1e-12, atol=1e-12)
    for input_dim in (-1, 0, 3):
        with pytest.raises(InvalidArgumentError, match=f"between 1 and the 2 positions, got {input_dim}"):
            GaussianMixture.fit(demos, 1, input_dim=input_dim)


MOTIONS = ["Angle", "BendedLine", "CShape", "GShape", "heee", "JShape", "Khamesh", "NShape", "Sine", "Worm"]


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.slow
def test_a_mixture_does_not_depend_on_the_units_of_length_and_time(name):
    """The field A_k, b_k of ten motions at 1e-9 to 1e9 of their size, and a thousand times as slow."""
    demos = load_lasa(name, 3).every(20)
    x = demos.stacked().x
    field = GMRPolicy.from_mixture(GaussianMixture.fit(demos, 4, n_init=1), 2)(x)
    for scale in (1e-9, 1e-3, 1e9):
        other = GMRPolicy.from_mixture(GaussianMixture.fit(demos.scale(scale), 4, n_init=1), 2)(scale * x)
        assert_close(other / scale, field, rtol=1e-4, atol=1e-4 * float(field.detach().abs().max()))
    slow = Demonstrations([d.x for d in demos], [d.v / 1e3 for d in demos], dt=[1e3 * d.dt for d in demos])
    other = GMRPolicy.from_mixture(GaussianMixture.fit(slow, 4, n_init=1), 2)(x)
    assert_close(1e3 * other, field, rtol=1e-4, atol=1e-4 * float(field.detach().abs().max()))


@pytest.mark.slow
def test_a_constant_axis_or_a_large_stiffness_swallows_no_motion(randn):
    """Floors are shares of the positions, of the velocities and of the stiffness, each for itself."""
    t = torch.linspace(0, 1, 80, dtype=torch.float64)
    x = torch.stack([0.004 * torch.sin(2 * t), 0.004 * t**2, 0 * t], -1)
    s = 1e5 * torch.stack([1 + t], -1)
    demos = Demonstrations([x], dt=1 / 79, stiffness=[s])
    policy = GMRPolicy.from_mixture(GaussianMixture.fit(demos, 4), 3, stiffness_dim=1)
    v = policy(x).detach()[:, :3]
    assert float((v - demos[0].v).norm() / demos[0].v.norm()) < 0.1


@pytest.mark.slow
def test_suspicious_demonstrations_are_named_by_the_fit():
    t = torch.linspace(0, 1, 50, dtype=torch.float64)
    demos = Demonstrations([torch.stack([t, t**2], -1)], [torch.stack([-1 + 0 * t, -2 * t], -1)], dt=1 / 49)
    with pytest.warns(DemonstrationWarning, match="velocity sign") as said:
        GaussianMixture.fit(demos, 2)
    assert said[0].filename == __file__


@pytest.mark.parametrize(
    ("n_components", "options", "message"),
    [
        ("aic", {}, "n_components has to be a number or 'bic', got 'aic'"),
        (0, {}, "n_components has to be at least 1, got 0"),
        (2, {"covariance_floor": 0.0}, "covariance_floor has to be positive, got 0.0"),
        (2, {"covariance_floor": float("nan")}, "covariance_floor has to be positive, got nan"),
        ("bic", {"max_components": 0}, "max_components has to be at least 1, got 0"),
    ],
)
def test_arguments_out_of_range_are_refused(clusters, n_components, options, message):
    with pytest.raises(InvalidArgumentError, match=re.escape(message)):
        GaussianMixture.fit(clusters, n_components, **options)


# ---------------------------------------------------------------------- degenerate samples: y (60, 4), three components


def with_row(y, value):
    return torch.cat([y[:30], torch.full((1, 4), value, dtype=y.dtype), y[30:]])


def with_column(y, column):
    return torch.cat([y[:, :3], column], -1)


FITTED = {
    "collinear": lambda y: torch.linspace(0, 1, 60, dtype=y.dtype)[:, None] * y[0],
    "duplicated": lambda y: y[:20].repeat(3, 1),
    "constant output": lambda y: with_column(y, torch.full_like(y[:, :1], 3.0)),
    "constant input": lambda y: with_column(y, torch.full_like(y[:, :1], 3.0)).flip(-1),
    "one variable twice another": lambda y: with_column(y, 2 * y[:, :1]),
    "outlier of 1e6": lambda y: with_row(y, 1e6),
    "as many samples as components": lambda y: y[:3],
    "tiny": lambda y: 1e-8 * y,
    "tiniest": lambda y: 1e-200 * y,
    "huge": lambda y: 1e8 * y,
    "collinear and huge": lambda y: 1e8 * torch.linspace(0, 1, 60, dtype=y.dtype)[:, None] * y[0],
    "far away": lambda y: y + 1e8,
    "integers": lambda y: (3 * y).round().int(),
}

REFUSED = {
    "empty": (lambda y: y[:0], "samples have to be an array (M, F), got shape (0, 4)"),
    "without variables": (lambda y: y[:, :0], "samples have to be an array (M, F), got shape (60, 0)"),
    "one-dimensional": (lambda y: y[:, 0], "samples have to be an array (M, F), got shape (60,)"),
    "not a number": (
        lambda y: with_row(y, torch.nan),
        "have to be finite and below 1e150, got nan in sample 30, variable 0",
    ),
    "infinite": (
        lambda y: with_row(y, -torch.inf),
        "have to be finite and below 1e150, got -inf in sample 30, variable 0",
    ),
    "squares overflow": (
        lambda y: with_row(y, 1e200),
        "have to be finite and below 1e150, got 1e+200 in sample 30, variable 0",
    ),
    "one sample": (lambda y: y[:1], "samples have to be at least 2, got 1; record more samples"),
    "fewer samples than components": (lambda y: y[:2], "number of distinct samples, 2 among 2, got 3; record more"),
    "fewer distinct samples": (
        lambda y: y[:2].repeat(30, 1),
        "2 among 60, got 3; record more samples or choose n_comp",
    ),
    "all constant": (lambda y: torch.ones_like(y), "1 among 60, got 3; record more samples or choose n_components ≤ 1"),
}


@pytest.mark.parametrize("kind", FITTED)
@pytest.mark.slow
def test_degenerate_samples_that_can_be_fitted_give_finite_policies(randn, kind):
    y = FITTED[kind](randn(60, 4))
    mixture = GaussianMixture.fit(y, 3)
    y = y.double()
    assert mixture.log_prob(y).isfinite().all()
    policy = GMRPolicy.from_mixture(mixture, 2)
    x = torch.cat([y[:, :2], torch.zeros(1, 2, dtype=y.dtype), torch.full((1, 2), 1e9, dtype=y.dtype)])
    h = policy.gating(x)
    assert_close(h.sum(-1), torch.ones(len(x), dtype=y.dtype), rtol=0, atol=1e-12)
    assert policy(x).isfinite().all()
    # predictions stay within the scale of the data, where the data are
    assert policy(y[:, :2]).abs().max() <= 10 * y.abs().max()


@pytest.mark.parametrize("kind", REFUSED)
def test_degenerate_samples_that_cannot_be_fitted_are_refused_with_a_way_out(randn, kind):
    make, message = REFUSED[kind]
    with pytest.raises(DegenerateMixtureError, match=re.escape(message)):
        GaussianMixture.fit(make(randn(60, 4)), 3)


@pytest.mark.slow
def test_a_floor_that_rounding_swallows_is_refused_and_a_larger_one_is_the_way_out(randn):
    y = FITTED["collinear and huge"](randn(60, 4))
    with pytest.raises(DegenerateMixtureError, match="raise the floor or take fewer components"):
        GaussianMixture.fit(y, 3, covariance_floor=1e-6)
    policy = GMRPolicy.from_mixture(GaussianMixture.fit(y, 3, covariance_floor=1e6), 2)
    assert_close(policy(y[:, :2]), y[:, 2:], rtol=0, atol=1e-6 * y.abs().max().item())


def test_equal_samples_and_one_component_give_a_constant_policy(randn):
    y = randn(1, 4).expand(60, 4)
    for n_components in (1, "bic"):
        policy = GMRPolicy.from_mixture(GaussianMixture.fit(y, n_components), 2)
        assert_close(policy(randn(5, 2)), y[:5, 2:], rtol=1e-9, atol=1e-9)
