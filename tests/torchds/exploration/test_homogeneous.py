"""Homogeneous exploration against Eq. 14-18 written out, and against the speeds it promises."""

import numpy as np
import pytest
import scipy.stats
import torch
from torch import nn

from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError
from torchds.exploration import Homogeneous
from torchds.exploration.homogeneous import chi_mean
from torchds.optim import PIBB

MEANS = np.array([[2.0, -0.5], [0.0, 1.5], [-3.0, 1e-4]])  # two of the coordinates lie on an axis, or nearly
COVARIANCES = np.array([[[0.5, 0.2], [0.2, 0.3]], [[0.04, 0.0], [0.0, 1.0]], [[1.0, -0.6], [-0.6, 2.0]]])


def make_policy(means=MEANS, covariances=COVARIANCES, O=2, Q=0, dtype=torch.float64):
    means, covariances = torch.as_tensor(means, dtype=dtype), torch.as_tensor(covariances, dtype=dtype)
    K, D = means.shape
    sizes = {"A": (K, O, D), "b": (K, O), "stiffness_A": (K, Q, D), "stiffness_b": (K, Q)}
    values = {name: torch.zeros(size, dtype=dtype) for name, size in sizes.items()}
    return GMRPolicy(torch.full((K,), 1 / K, dtype=dtype), means, covariances, **values)


def make_one_component(D, O, Q=0):
    means = torch.linspace(-2.0, 3.0, D)[None]
    return make_policy(means, 0.3 * torch.eye(D)[None], O, Q)


def draw(exploration, n, seed=0):
    """The noise of all parameters by name."""
    generator = torch.Generator().manual_seed(seed)
    named = dict(exploration.policy.named_parameters())
    normals = [torch.randn(n, *p.shape, dtype=p.dtype, generator=generator) for p in named.values()]
    return dict(zip(named, exploration(list(named.values()), normals), strict=True))


def slope_variance(rule, speed, mean, covariance, j, d):
    """σ² of A_{j,d} at one 2-D Gaussian, as Eq. 15-17 have it."""
    share = 2 * speed**2 / (3 * np.pi)
    if rule == "moment":
        return share / (mean[d] ** 2 + covariance[d, d])
    i = {"centre": d, "printed": j}[rule]
    return share / max(abs(mean[i]), 0.01 * np.sqrt(covariance[i, i])) ** 2


@pytest.mark.parametrize("rule", ["moment", "centre", "printed"])
@pytest.mark.parametrize("speed", [0.1, 7.0])
def test_the_variances_in_2d_are_those_of_equations_15_to_18(rule, speed):
    std = Homogeneous(make_policy(), speed, rule).std()
    expected = [
        [[slope_variance(rule, speed, MEANS[k], COVARIANCES[k], j, d) for d in range(2)] for j in range(2)]
        for k in range(3)
    ]
    assert set(std) == {"A", "b"}
    np.testing.assert_allclose(std["A"].square(), expected, rtol=1e-12)
    np.testing.assert_allclose(std["b"].square(), np.full((3, 2), 2 * speed**2 / (3 * np.pi)), rtol=1e-12)


def test_the_printed_indices_differ_from_the_derived_ones():
    """Guards the comparison above: a policy whose two coordinates are alike could not tell the rules apart."""
    policy = make_policy()
    printed, centre = (Homogeneous(policy, rule=rule).std()["A"] for rule in ("printed", "centre"))
    torch.testing.assert_close(printed, centre.mT, rtol=1e-12, atol=0)
    assert not torch.allclose(printed, centre)


@pytest.mark.parametrize("dim", range(1, 8))
def test_the_mean_norm_of_a_normal_vector_is_that_of_scipy(dim):
    assert chi_mean(dim) == pytest.approx(scipy.stats.chi(dim).mean(), rel=1e-12)


@pytest.mark.parametrize(("D", "O"), [(1, 1), (2, 1), (2, 2), (3, 3), (2, 3), (4, 5)])
def test_the_velocity_noise_at_a_centre_has_the_mean_speed(D, O):
    n, speed = 20_000, 0.7
    policy = make_one_component(D, O)
    noise = draw(Homogeneous(policy, speed, "centre"), n)
    velocity = noise["A"][:, 0].numpy() @ policy.means[0].numpy() + noise["b"][:, 0].numpy()
    norms = np.linalg.norm(velocity, axis=-1)
    # Four standard errors (0.3 - 0.6 %): the first wrong candidate, D shares in place of D + 1, is off by 10 % or more.
    assert abs(norms.mean() - speed) < 4 * norms.std() / np.sqrt(n)
    covariance = np.atleast_2d(np.cov(velocity.T)) / (speed / chi_mean(O)) ** 2
    np.testing.assert_allclose(covariance, np.eye(O), atol=6 / np.sqrt(n))  # isotropic; a variance has √2/√n


@pytest.mark.parametrize("Q", [1, 2])
def test_the_stiffness_noise_at_a_centre_has_the_mean_size(Q):
    n = 20_000
    policy = make_one_component(2, 2, Q)
    noise = draw(Homogeneous(policy, rule="centre", mean_stiffness=30.0), n)
    rows = noise["stiffness_A"][:, 0].numpy() @ policy.means[0].numpy() + noise["stiffness_b"][:, 0].numpy()
    sizes = np.abs(rows)  # (n, Q)
    assert (np.abs(sizes.mean(0) - 30.0) < 4 * sizes.std(0) / np.sqrt(n)).all()


@pytest.mark.parametrize("rule", ["moment", "centre", "printed"])
def test_the_stiffness_rows_follow_the_input_they_multiply_under_every_rule(rule):
    std = Homogeneous(make_policy(Q=1), rule=rule, mean_stiffness=2.0).std()
    share = 4.0 * np.pi / 2 / 3  # E|z| = √(2/π) in one dimension, D + 1 = 3 terms
    base = "moment" if rule == "moment" else "centre"
    unit = [
        [slope_variance(base, 1.0, MEANS[k], COVARIANCES[k], 0, d) * 3 * np.pi / 2 for d in range(2)] for k in range(3)
    ]
    np.testing.assert_allclose(std["stiffness_A"].square(), share * np.array(unit)[:, None], rtol=1e-12)
    np.testing.assert_allclose(std["stiffness_b"].square(), np.full((3, 1), share), rtol=1e-12)


def test_zero_sizes_leave_the_parameters_alone():
    noise = draw(Homogeneous(make_policy(Q=1), mean_speed=0.0, mean_stiffness=0.0), 3)
    assert all(not epsilon.any() for epsilon in noise.values())
    noise = draw(Homogeneous(make_policy(Q=1)), 3)
    assert [bool(noise[name].all()) for name in ("A", "b", "stiffness_A", "stiffness_b")] == [True, True, False, False]


@pytest.mark.parametrize("rule", ["moment", "centre", "printed"])
def test_a_direction_keeps_the_total_variance_and_sets_the_ratio(rule):
    policy = make_policy(Q=1)
    plain = Homogeneous(policy, rule=rule, mean_stiffness=1.0).std()
    for direction in ([3.0, 1.0], [30, 10], [1.0, 0.0]):
        std = Homogeneous(policy, rule=rule, mean_stiffness=1.0, direction=torch.tensor(direction)).std()
        np.testing.assert_allclose(std["b"].square().sum(-1), plain["b"].square().sum(-1), rtol=1e-12)
        relative = (std["A"] / plain["A"]).square()
        np.testing.assert_allclose(relative.sum(-2), np.full((3, 2), 2.0), rtol=1e-12)
        np.testing.assert_allclose(std["b"][:, 1] * direction[0], std["b"][:, 0] * direction[1], rtol=1e-12)
        np.testing.assert_allclose(relative[:, 1] * direction[0] ** 2, relative[:, 0] * direction[1] ** 2, rtol=1e-12)
        assert torch.equal(std["stiffness_A"], plain["stiffness_A"])


@pytest.mark.parametrize("rule", ["moment", "centre", "printed"])
def test_float32_gives_the_same_in_float32(rule):
    options = {"rule": rule, "direction": torch.tensor([2.0, 1.0], dtype=torch.float64), "mean_stiffness": 5.0}
    single, double = (Homogeneous(make_policy(Q=2, dtype=t), 0.3, **options) for t in (torch.float32, torch.float64))
    for name, std in single.std().items():
        torch.testing.assert_close(std, double.std()[name].float(), rtol=1e-5, atol=0)
        assert std.shape == single.policy.get_parameter(name).shape
    assert {epsilon.dtype for epsilon in draw(single, 2).values()} == {torch.float32}


def test_a_batch_of_policies_gets_the_noise_of_each():
    policy = make_policy(Q=1)
    batch = Homogeneous(policy.expand(4), mean_stiffness=2.0)
    noise = draw(batch, 5)
    normals = {name: epsilon / batch.std()[name] for name, epsilon in noise.items()}
    single = Homogeneous(policy, mean_stiffness=2.0)
    for name, p in policy.named_parameters():
        assert noise[name].shape == (5, 4, *p.shape)
        (alone,) = single([p], [normals[name][:, 2]])
        torch.testing.assert_close(noise[name][:, 2], alone, rtol=1e-14, atol=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mean_speed": -1.0}, "mean_speed has to be finite and ≥ 0, got -1.0"),
        ({"mean_speed": float("nan")}, "mean_speed has to be finite and ≥ 0, got nan"),
        ({"mean_stiffness": float("inf")}, "mean_stiffness has to be finite and ≥ 0, got inf"),
        ({"rule": "center"}, "rule has to be one of 'moment', 'centre', 'printed', got 'center'"),
        ({"O": 3, "rule": "printed"}, "rule='printed' pairs outputs with inputs; this policy has 3 and 2"),
        ({"direction": torch.ones(3)}, "direction has to be 2 numbers ≥ 0, one of them positive; got tensor"),
        ({"direction": torch.ones(1, 2)}, "direction has to be 2 numbers ≥ 0"),
        ({"direction": torch.tensor([1.0, -1.0])}, "direction has to be 2 numbers ≥ 0"),
        ({"direction": torch.tensor([1.0, float("inf")])}, "direction has to be 2 numbers ≥ 0"),
        ({"direction": torch.zeros(2)}, "one of them positive"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    options = dict(options)
    with pytest.raises(InvalidArgumentError, match=message):
        Homogeneous(make_policy(O=options.pop("O", 2)), **options)


@pytest.mark.parametrize("stranger", [nn.Linear(2, 5), make_policy()])
def test_parameters_of_another_module_are_refused(stranger):
    message = r"Homogeneous explores \['A', 'b'\] of the policy it was made with.*parameters of shape \[\((5|3), 2"
    exploration = Homogeneous(make_policy())
    with pytest.raises(InvalidArgumentError, match=message):
        PIBB(stranger.parameters(), exploration=exploration)
    with pytest.raises(InvalidArgumentError, match=message):
        exploration(list(stranger.parameters()), [])


def test_the_size_of_the_noise_follows_what_it_depends_on(random_policy):
    policy = random_policy(3, Q=1)
    noise = Homogeneous(policy, 0.1, mean_stiffness=2.0)
    first = noise.std()
    first["A"].zero_()  # what was given out is the caller's
    assert (noise.std()["A"] > 0).all()
    noise.mean_speed = 0.2
    torch.testing.assert_close(noise.std()["b"], 2.0 * first["b"], rtol=1e-15, atol=0)
    policy.means.mul_(2.0)
    torch.testing.assert_close(
        noise.std()["A"], Homogeneous(policy, 0.2, mean_stiffness=2.0).std()["A"], rtol=0, atol=0
    )
    noise.direction = torch.tensor([1.0, 0.0])
    assert (noise.std()["b"][:, 1] == 0).all()
    policy.float()
    assert noise.std()["A"].dtype == torch.float32
