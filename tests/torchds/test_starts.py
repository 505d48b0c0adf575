"""The mixtures that fits start from, against scikit-learn on data normalised by hand."""

import numpy as np
import pytest
import sklearn.mixture
import torch
from torch.testing import assert_close

import torchds
from torchds import Demonstrations, GaussianMixture, fit_mixtures
from torchds.errors import InvalidArgumentError
from torchds.starts import Samples, sequence


def motion(name, n_demos=3):
    return torchds.load_lasa(name, n_demos).every(10)


@pytest.fixture(scope="module")
def angle():
    return motion("Angle")


@pytest.mark.slow
def test_mixtures_are_those_of_the_data(angle):
    """In units of the data: the marginal densities of the padded batch are those of one fit alone."""
    both = fit_mixtures([angle, motion("Sine", 2)], [2, 4])
    alone = fit_mixtures(angle, 2)
    x, v, _ = angle.stacked()
    y = torch.cat([x, v], -1)
    assert_close(both.log_prob(y.expand(2, -1, -1))[0], alone.log_prob(y))
    spread = torch.cov(y.T)
    mean = (alone.priors[:, None] * alone.means).sum(0)
    assert_close(mean, y.mean(0), rtol=1e-4, atol=1e-4)
    off = alone.means - mean
    total = (alone.priors[:, None, None] * (alone.covariances + off[:, :, None] * off[:, None])).sum(0)
    assert_close(total, spread, rtol=0.01, atol=0.02 * float(spread.max()))


@pytest.mark.slow
def test_bic_chooses_more_components_for_the_longer_shape():
    n = (fit_mixtures([motion("Line"), motion("Worm")], "bic", max_components=8).priors > 0).sum(-1)
    assert 1 < n[0] < n[1] <= 8


def test_a_mixture_is_that_of_scikit_learn_in_normalised_units():
    """Moved away from the origin, so that the goal has to be subtracted and added again."""
    demos = motion("Sharpc").shift_to_goal([300.0, -50.0])
    x, v = np.concatenate([d.x for d in demos]), np.concatenate([d.v for d in demos])
    origin = np.array([300.0, -50.0, 0.0, 0.0])
    scale = np.repeat([np.sqrt(((x - origin[:2]) ** 2).mean()), np.sqrt((v**2).mean())], 2)
    em = sklearn.mixture.GaussianMixture(3, reg_covar=1e-4, tol=1e-3, max_iter=1000, random_state=7)
    em.fit((np.concatenate([x, v], -1) - origin) / scale)
    mixture = fit_mixtures(demos, 3, seed=7)
    assert_close(mixture.priors.numpy(), em.weights_, rtol=1e-6, atol=1e-9)
    assert_close(mixture.means.numpy(), em.means_ * scale + origin, rtol=1e-6, atol=1e-6)
    assert_close(mixture.covariances.numpy(), em.covariances_ * np.outer(scale, scale), rtol=1e-6, atol=1e-6)


def test_samples_are_normalised_padded_and_weighted(angle):
    other = motion("Sine", 2)
    goal = torch.tensor([[1.0, 2.0], [-3.0, 4.0]], dtype=torch.float64)
    samples = Samples.of([angle, other], goal)
    for i, demos in enumerate((angle, other)):
        x, v, _ = demos.stacked()
        n = len(x)
        for part, scale, raw in ((samples.x, samples.x_scale, x - goal[i]), (samples.v, samples.v_scale, v)):
            assert_close(part[i, :n] * scale[i], raw)
            assert_close(float(part[i, :n].square().mean()), 1.0)
            assert not part[i, n:].any()
        assert_close(samples.weight[i, :n], torch.full((n,), 1 / n, dtype=torch.float64))
        assert not samples.weight[i, n:].any()


def test_without_a_goal_it_is_where_the_demonstrations_end_on_average():
    demos = Demonstrations([[[0.0, 0.0], [2.0, 1.0]], [[5.0, 5.0], [4.0, 3.0]]], dt=0.1)
    assert Samples.of([demos], None).goal.tolist() == [[3.0, 2.0]]


def test_restoring_undoes_normalising(angle, random_mixture):
    samples = Samples.of([angle, motion("Sine", 2)], None)
    mixture = random_mixture(K=3, F=4, batch=(2,))
    back = samples.restore(samples.normalise(mixture))
    for name in ("priors", "means", "covariances"):
        assert_close(getattr(back, name), getattr(mixture, name))
    x = mixture.means[..., :2] + 0.1
    assert_close(  # h does not depend on the units
        samples.normalise(mixture)
        .marginal(0, 2)
        .component_log_prob((x - samples.goal[:, None]) / samples.x_scale[:, None, None])
        .softmax(-1),
        mixture.marginal(0, 2).component_log_prob(x).softmax(-1),
    )


def test_padding_has_no_part(angle):
    both = fit_mixtures([angle, angle], [2, 4])
    assert isinstance(both, GaussianMixture) and both.batch_shape == (2,)
    assert (both.priors > 0).sum(-1).tolist() == [2, 4] and not both.priors[0, 2:].any()


def test_arguments_that_do_not_fit_are_refused(angle):
    assert sequence(angle) == [angle] and sequence((angle, angle)) == [angle, angle]
    for demos in ([], [1], "Angle"):
        with pytest.raises(InvalidArgumentError, match="demos has to be Demonstrations or a sequence of them, got"):
            fit_mixtures(demos, 2)
    for goal in (torch.zeros(3), torch.zeros(2, 2), torch.tensor([0.0, torch.nan])):
        with pytest.raises(InvalidArgumentError, match=r"goal has to be finite and \(2,\) or \(1, 2\), got"):
            fit_mixtures(angle, 2, goal=goal)
