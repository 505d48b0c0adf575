import math

import pytest
import torch
from torch.testing import assert_close

import torchds
from torchds import Demonstrations, fit_mixtures, fit_stable, metrics, rollout
from torchds.errors import DemonstrationWarning, InvalidArgumentError, UnknownNameError


def motion(name, n_demos=3):
    return torchds.load_lasa(name, n_demos).every(10)


@pytest.fixture(scope="module")
def angle():
    return motion("Angle")


@pytest.fixture(scope="module")
def fitted(angle):
    """A fit of each condition to one motion, EM and all."""
    return {
        condition: fit_stable(angle, n_components=5, condition=condition, n_steps=250)
        for condition in ("none", "seds", "p-qlf")
    }


def error(fit, demos):
    x, v, _ = demos.stacked()
    return float(metrics.velocity_rmse(v, fit.policy(x).detach()))


# ---------------------------------------------------------------------- what a fit promises


@pytest.mark.slow
@pytest.mark.parametrize(("condition", "bound"), [("none", 5.0), ("seds", 5.8), ("p-qlf", 5.5)])
def test_a_fit_is_close_to_the_demonstrations(fitted, angle, condition, bound):
    """In mm/s, at a mean speed of 33; the mixture that the fits start from, which is not stable, has 3.9."""
    assert error(fitted[condition], angle) < bound


def test_stiffness_that_is_left_out_is_said(angle):
    with pytest.warns(DemonstrationWarning, match="carry a stiffness, which is left out"):
        fit = fit_stable(angle.with_stiffness(100.0), n_components=2, condition="seds", n_steps=10)
    assert fit.policy.stiffness_dim == 0


@pytest.mark.parametrize("condition", ["seds", "p-qlf"])
def test_a_fit_is_certified_with_its_margin(fitted, angle, condition):
    fit = fitted[condition]
    x, v, _ = angle.stacked()
    rate = float((v.square().mean() / (x - fit.goal).square().mean()).sqrt())
    proof = fit.certificate()
    assert proof.stable
    assert float(proof.margin) >= 0.03 * rate * (1 - 1e-9)
    assert_close(fit.policy.b.data, -(fit.policy.A.data @ fit.goal), rtol=1e-12, atol=1e-12)


def test_the_metric_is_the_identity_for_seds_and_learned_for_p_qlf(fitted):
    eye = torch.eye(2, dtype=torch.float64)
    assert torch.equal(fitted["seds"].P, eye)
    assert (fitted["p-qlf"].P - eye).abs().max() > 0.1
    assert float(fitted["p-qlf"].P.trace()) == pytest.approx(2.0)
    assert float(fitted["p-qlf"].loss) < float(fitted["seds"].loss)


@pytest.mark.parametrize("condition", ["seds", "p-qlf"])
@pytest.mark.slow
def test_every_start_ends_at_the_goal(fitted, condition):
    fit = fitted[condition]
    side = torch.linspace(-150, 150, 8, dtype=torch.float64)
    path = rollout(fit.policy, torch.cartesian_prod(side, side), n_steps=4000, dt=0.02)
    assert (path.x[..., -1, :] - fit.goal).norm(dim=-1).max() < 1.0  # mm


@pytest.mark.slow
def test_a_fit_is_an_ordinary_policy_in_the_units_of_the_data(fitted, angle):
    policy = fitted["p-qlf"].policy
    assert policy.batch_shape == ()
    assert policy.A.dtype == torch.float64
    assert float(policy.priors.sum()) == pytest.approx(1.0)
    metres = fit_stable(angle.scale(1e-3), n_components=5, n_steps=250)
    assert_close(metres.policy.A.data, policy.A.data, rtol=0.05, atol=0.05)  # 1/s in both
    assert error(metres, angle.scale(1e-3)) == pytest.approx(1e-3 * error(fitted["p-qlf"], angle), rel=0.02)


@pytest.mark.slow
def test_equal_seeds_give_equal_fits_and_other_seeds_other_ones(fitted, angle):
    again = fit_stable(angle, n_components=5, n_steps=250)
    assert torch.equal(again.policy.A, fitted["p-qlf"].policy.A)
    other = fit_stable(angle, n_components=5, n_steps=250, seed=3)
    assert not torch.allclose(other.policy.means, again.policy.means)


@pytest.mark.slow
@pytest.mark.parametrize("condition", ["none", "seds", "p-qlf"])
def test_the_likelihood_is_an_objective_too(angle, condition):
    first, last = (fit_stable(angle, 4, condition, "likelihood", n_steps=n) for n in (10, 200))
    assert float(last.loss) < float(first.loss)
    assert error(last, angle) < 11.0  # the likelihood weighs errors by their noise, slow parts count more
    assert last.certificate().stable or condition == "none"


# ---------------------------------------------------------------------- goals


@pytest.mark.slow
def test_the_goal_is_where_the_demonstrations_end_or_where_one_says(angle, fitted):
    ends = torch.stack([demo.x[-1] for demo in angle]).mean(0)
    assert_close(fitted["seds"].goal, ends)
    goal = torch.tensor([5.0, -3.0])
    fit = fit_stable(angle, 3, goal=goal, n_steps=10)
    assert fit.goal.tolist() == [5.0, -3.0]
    assert fit.certificate().stable
    assert fit.policy(goal.double()).abs().max() < 1e-10


@pytest.mark.slow
def test_a_fit_moves_with_its_demonstrations(angle, fitted):
    shift = torch.tensor([200.0, -100.0], dtype=torch.float64)
    moved = Demonstrations([demo.x + shift for demo in angle], [demo.v for demo in angle], dt=angle.dt)
    fit = fit_stable(moved, n_components=5, n_steps=250)
    assert_close(fit.goal, fitted["p-qlf"].goal + shift)
    assert error(fit, moved) == pytest.approx(error(fitted["p-qlf"], angle), rel=0.02)


# ---------------------------------------------------------------------- batches


@pytest.mark.slow
def test_a_batch_of_motions_and_numbers_of_components_equals_single_fits(angle):
    """Up to the order of sums in float32, which steps of Adam make larger."""
    shorter = motion("Sine", 2)  # fewer samples: its fit is padded in both ways
    together = fit_stable([angle, shorter, angle], n_components=[5, 3, 5], seed=[0, 0, 1], n_steps=60)
    assert together.policy.batch_shape == (3,)
    assert together.n_components.tolist() == [5, 3, 5]
    assert together.goal.shape == (3, 2)
    assert together.certificate().stable.tolist() == [True] * 3
    assert together.policy.priors[1, 3:].tolist() == [0.0, 0.0]
    for i, (demos, K, seed) in enumerate(((angle, 5, 0), (shorter, 3, 0), (angle, 5, 1))):
        alone = fit_stable(demos, K, seed=seed, n_steps=60)
        x = demos.stacked().x
        assert float(together.loss[i]) == pytest.approx(float(alone.loss), rel=0.02)
        assert_close(together.policy[i](x), alone.policy(x), rtol=0.05, atol=0.5)


@pytest.mark.slow
def test_a_fit_does_not_depend_on_a_longer_motion_beside_it():
    """Its jitter and the metric that it starts from are drawn and averaged over its own samples, not over the padding."""
    worm, longer = motion("Worm"), torchds.load_lasa("Angle").every(8)
    assert len(longer.stacked().x) > 2 * len(worm.stacked().x)
    alone, beside = fit_stable(worm, 4), fit_stable([worm, longer], [4, 6])
    for ours, theirs in ((alone.policy.A, beside.policy.A[0, :4]), (alone.P, beside.P[0])):
        assert_close(theirs, ours, rtol=1e-3, atol=1e-3 * float(ours.detach().abs().max()))


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e9])
@pytest.mark.slow
def test_a_fit_does_not_depend_on_the_unit_of_length(angle, scale):
    ours, theirs = (fit_stable(demos, 3, n_steps=20) for demos in (angle, angle.scale(scale)))
    assert_close(theirs.policy.A.data, ours.policy.A.data, rtol=1e-3, atol=1e-3)
    assert_close(theirs.goal / scale, ours.goal)


@pytest.mark.slow
def test_a_batch_of_one_keeps_its_batch(angle):
    fit = fit_stable([angle], 2, n_steps=10)
    assert fit.policy.batch_shape == (1,)
    assert fit.P.shape == (1, 2, 2)
    assert fit.loss.shape == fit.n_components.shape == (1,)


@pytest.mark.slow
def test_fits_may_share_a_start(angle, fitted):
    start = fit_mixtures(angle, 5)
    assert start.batch_shape == ()
    assert fit_mixtures([angle], 5).batch_shape == (1,)
    fit = fit_stable(angle, start=start, n_steps=250)
    assert_close(fit.policy.A.data, fitted["p-qlf"].policy.A.data, rtol=1e-2, atol=1e-2)  # units there and back


@pytest.mark.slow
def test_a_fit_does_not_need_the_callers_gradients(angle):
    with torch.no_grad():
        assert fit_stable(angle, 2, n_steps=10).certificate().stable


@pytest.mark.slow
def test_three_dimensions(randn):
    t = torch.linspace(0, 1, 60, dtype=torch.float64)[:, None]
    paths = [torch.cat([1 - t, (math.pi * t).sin(), t * (1 - t)], -1) * (1 + 0.1 * i) for i in range(3)]
    demos = Demonstrations(paths, dt=0.05)
    fit = fit_stable(demos, 4, n_steps=150)
    assert fit.certificate().stable
    assert error(fit, demos) < 0.25 * float(demos.stacked().v.square().mean().sqrt())


# ---------------------------------------------------------------------- suspicious motions


@pytest.mark.parametrize("fit", [lambda demos: fit_stable(demos, 2, n_steps=10), lambda demos: fit_mixtures(demos, 2)])
@pytest.mark.slow
def test_a_fit_says_what_is_suspicious_about_its_motions(angle, fit):
    backward = Demonstrations([d.x for d in angle], [-d.v for d in angle], dt=angle.dt)
    with pytest.warns(DemonstrationWarning) as said:
        fit(backward)
    texts = [str(warning.message) for warning in said]
    assert len(texts) == len(angle)
    assert all("[velocity sign]. Call differentiate()" in text for text in texts)
    assert all(warning.filename == __file__ for warning in said)


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"condition": "sed"}, UnknownNameError, "unknown condition 'sed'. Did you mean 'seds'"),
        ({"objective": "speed"}, UnknownNameError, "unknown objective 'speed'"),
        ({"margin": -0.1}, InvalidArgumentError, "margin has to be above 0 and finite, got -0.1"),
        ({"margin": 0.0}, InvalidArgumentError, "margin has to be above 0 and finite, got 0.0"),
        ({"spread": -1.0}, InvalidArgumentError, "spread has to be finite and ≥ 0, got -1.0"),
        ({"n_steps": 5}, InvalidArgumentError, "n_steps has to be at least 10, got 5"),
        ({"goal": torch.zeros(3)}, InvalidArgumentError, r"goal has to be finite and \(2,\) or \(1, 2\), got \[0.0"),
        (
            {"n_components": [2, 3]},
            InvalidArgumentError,
            "n_components has to be one for all or one for each of the 1 motions, got 2",
        ),
        ({"seed": [0, 1]}, InvalidArgumentError, "seed has to be one for all or one for each of the 1 motions, got 2"),
        ({"n_components": "aic"}, InvalidArgumentError, "n_components has to be a number or 'bic', got 'aic'"),
        ({"n_components": 0}, InvalidArgumentError, "n_components has to be at least 1, got 0"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(angle, options, kind, message):
    with pytest.raises(kind, match=message):
        fit_stable(angle, **{"n_components": 2, "n_steps": 10} | options)


def test_motions_that_do_not_fit_are_refused(angle, random_mixture):
    other = Demonstrations([torch.rand(20, 3)], dt=0.1)
    with pytest.raises(InvalidArgumentError, match=r"the motions of a batch have to have one dimension, got \[2, 3\]"):
        fit_stable([angle, other], 2)
    with pytest.raises(InvalidArgumentError, match="demos has to be Demonstrations or a sequence of them"):
        fit_stable([], 2)
    with pytest.raises(InvalidArgumentError, match="every motion has to move"):
        fit_stable(Demonstrations([torch.ones(20, 2)], dt=0.1), 2)
    with pytest.raises(InvalidArgumentError, match=r"start has to be 1 mixtures of 4 variables.*batch_shape=\(2,\)"):
        fit_stable(angle, start=random_mixture(F=4, batch=(2,)))
