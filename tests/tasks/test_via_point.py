import numpy as np
import pytest
import torch

import tasks
from tasks.released.exploration import ReleasedHomogeneous
from torchds import Demonstrations, GaussianMixture
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.optim import PIBB, InverseIteration


def learn(task, n_runs, seed):
    """The paper's search on a task: final noise-free costs `(n_runs,)`."""
    from torchds.exploration import Homogeneous

    policy = task.policy().expand(n_runs)
    optim = PIBB(
        policy.parameters(),
        exploration=Homogeneous(policy, task.search.mean_speed),
        n_rollouts=task.search.n_rollouts,
        control_weight=task.search.control_weight,
        generator=torch.Generator().manual_seed(seed),
    )
    decay = torch.optim.lr_scheduler.LambdaLR(optim, InverseIteration())
    for _ in range(task.search.n_updates):
        optim.step(lambda: task.cost(task.rollout(policy)))
        decay.step()
    with torch.no_grad():
        return tasks.base.total(task.evaluate(policy)[1].values())


@pytest.mark.parametrize(("shape", "initial", "bound"), [("N", 3.1, 0.20), ("P", 4.4, 0.60)])
def test_with_the_papers_settings_the_median_of_20_runs_passes_the_via_points(shape, initial, bound):
    task = tasks.make("via_point", shape=shape)
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    assert sum(terms.values()) == pytest.approx(initial, abs=0.05)
    assert path.x.shape == (201, 2)
    assert learn(task, 20, seed=0).median() <= bound


def test_cost_terms_are_those_of_equation_39():
    task = tasks.make("via_point", shape="N")
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    x, v = path.x.numpy(), path.v.numpy()
    via = sum(min(((p - q) ** 2).sum() for q in x[1:]) for p in task.via_points.numpy())
    assert float(terms["via_points"]) == pytest.approx(via, rel=1e-12)
    assert float(terms["goal"]) == pytest.approx((x[-1] ** 2).sum(), rel=1e-12)
    acceleration = sum(((v[j] - v[j - 1]) ** 2).sum() ** 0.5 for j in range(1, len(v)))
    assert float(terms["acceleration"]) == pytest.approx(1e-4 * acceleration, rel=1e-12)
    assert float(terms["control"]) == 0.0


def test_the_control_term_of_a_changed_policy_is_its_squared_deviation():
    task = tasks.make("via_point", shape="P")
    policy = task.policy()
    with torch.no_grad():
        policy.A += 0.01
        _, terms = task.evaluate(policy)
    assert float(terms["control"]) == pytest.approx(0.5 * 5e-4 * 200 * 16 * 0.01**2, rel=1e-9)


def test_terms_have_the_shape_of_the_batch_of_policies():
    task = tasks.make("via_point")
    policy = task.policy().expand(3, 2)
    terms = task.cost_terms(task.rollout(policy))
    assert all(value.shape == (3, 2) for value in terms.values())


def test_demonstrations_and_mixture_can_be_given_as_objects_and_as_files(tmp_path):
    own = tasks.make("via_point")
    own.demonstrations.save_npz(tmp_path / "demos.npz")
    own.mixture.save(tmp_path / "mixture.npz")
    for options in (
        {"demonstrations": own.demonstrations},
        {"demonstrations": tmp_path / "demos.npz"},
        {"mixture": own.mixture},
        {"mixture": str(tmp_path / "mixture.npz")},
    ):
        given = tasks.make("via_point", **options)
        torch.testing.assert_close(given.policy().A, own.policy().A, rtol=0, atol=0)


def test_a_mixture_file_with_greek_names_is_read(tmp_path):
    m = tasks.make("via_point").mixture
    np.savez(tmp_path / "m.npz", gmm_priors=m.priors, gmm_mu=m.means, gmm_sigma=m.covariances)
    assert torch.equal(GaussianMixture.load(tmp_path / "m.npz").means, m.means)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"shape": "Q"}, InvalidArgumentError, "shape has to be 'N' or 'P', got 'Q'"),
        (
            {"convention": "draft"},
            InvalidArgumentError,
            "convention of task 'via_point' has to be 'paper' or 'released', got 'draft'",
        ),
        ({"convention": "released", "shape": "Q"}, InvalidArgumentError, "shape has to be 'N' or 'P', got 'Q'"),
        ({"shapes": "N"}, InvalidArgumentError, "has no option shapes; it has shape, demonstrations"),
    ],
)
def test_wrong_options_are_refused(options, error, words):
    with pytest.raises(error, match=words):
        tasks.make("via_point", **options)


def test_an_unknown_task_lists_the_near_names():
    with pytest.raises(UnknownNameError, match=r"unknown task 'viapoint'\. Did you mean 'via_point'"):
        tasks.make("viapoint")


# ------------------------------------------------------------------ as the released program has it

RELEASED = {
    "N": ((-130.0, -100.0), [(-120.0, -10.0), (-60.0, -40.0), (-30.0, -110.0)], 120),
    "P": ((-40.0, -20.0), [(-45.0, 20.0), (-10.0, 30.0), (10.0, 15.0)], 150),
}


def synthetic_mixture():
    """Two Gaussians in millimetres, with different experts that lead towards the origin."""
    means = np.array([[-90.0, -60.0], [-10.0, 5.0]])
    slopes = np.array([[[-0.3, 0.25], [-0.35, -0.2]], [[-0.4, -0.3], [0.2, -0.35]]])
    inputs = np.array([[[1600.0, 200.0], [200.0, 900.0]], [[700.0, -200.0], [-200.0, 500.0]]])
    velocities = np.einsum("kij,kj->ki", slopes, means) + np.array([[3.0, 2.0], [-2.0, 1.0]])
    centres = np.concatenate([means, velocities], -1)
    cross = slopes @ inputs
    covariances = np.block([[inputs, cross.swapaxes(1, 2)], [cross, cross @ slopes.swapaxes(1, 2) + np.eye(2)]])
    return GaussianMixture(*(torch.tensor(value) for value in (np.array([0.4, 0.6]), centres, covariances)))


def released_costs(policy, r, shape):
    """Steps and terms of one policy, the plant and all in numpy: N on the plant, P on the reference."""
    start, points, n_steps = RELEASED[shape]
    A, b = policy.A[r].detach().numpy(), policy.b[r].detach().numpy()
    reference = q = np.array(start)
    qd, path, squares = np.zeros(2), [], []
    for _ in range(n_steps):
        h = policy.gating(torch.from_numpy(reference)).numpy()
        v = sum(h[k] * (A[k] @ reference + b[k]) for k in range(len(h)))
        reference = reference + v * 0.1
        u = 10 * (reference - q) + 2 * np.sqrt(10) * (v - qd)
        qdd = u - qd
        qd = qd + qdd * 0.1
        q = q + qd * 0.1
        path.append(q if shape == "N" else reference)
        squares.append(1e-4 * (qdd**2).sum())
    via = sum(min(((np.array(p) - x) ** 2).sum() for x in path) for p in points)
    return squares, {"via_points": via, "goal": (path[-1] ** 2).sum(), "acceleration": sum(squares)}


@pytest.mark.parametrize("shape", ["N", "P"])
def test_cost_terms_are_those_of_the_released_program(shape):
    task = tasks.make("via_point", shape=shape, convention="released", mixture=synthetic_mixture())
    policy = task.policy().expand(3)
    generator = torch.Generator().manual_seed(9)
    with torch.no_grad():
        policy.A.add_(0.02 * torch.randn(policy.A.shape, generator=generator, dtype=torch.float64))
        policy.b.add_(1.0 * torch.randn(policy.b.shape, generator=generator, dtype=torch.float64))
        path, terms = task.evaluate(policy)
        by_steps = task.step_costs(path)
    n_steps = RELEASED[shape][2]
    assert path.x.shape == (3, n_steps + 1, 2)
    for r in range(3):
        squares, expected = released_costs(policy, r, shape)
        for name, value in expected.items():
            assert terms[name][r].item() == pytest.approx(value, rel=1e-9), name
        squares[-1] += expected["via_points"] + expected["goal"]
        np.testing.assert_allclose(by_steps[r], squares, rtol=1e-9)
        deviation = (policy.pack()[r] - task.policy().pack()).detach().numpy()
        assert terms["control"][r].item() == pytest.approx(n_steps * 0.5 * 5e-4 * (deviation**2).sum(), rel=1e-9)
    assert (path.x - path.reference).norm(dim=-1).amax() > 0.3  # plant and reference are not the same


def test_the_released_settings_are_those_of_its_program():
    search = tasks.make("via_point", convention="released", mixture=synthetic_mixture()).search
    assert (search.n_updates, search.n_rollouts, search.elite, search.control_weight) == (50, 10, "none", 5e-4)
    assert (search.homogeneous, search.temperature, search.decay) == (ReleasedHomogeneous, "median", "linear")
    assert search.mean_speed == 0.1


def test_the_released_policy_is_fitted_with_a_floor_that_is_added_twice():
    rng, s = np.random.default_rng(0), np.linspace(0, 1, 80)[:, None]
    curve = np.hstack([-130 * (1 - s) ** 2, -100 * (1 - s) + 80 * np.sin(5 * s) * (1 - s)])
    demonstrations = Demonstrations([curve + rng.normal(size=(80, 2)) for _ in range(3)], dt=0.1)
    task = tasks.make("via_point", convention="released", demonstrations=demonstrations)
    once = GaussianMixture.fit(demonstrations, 4, covariance_floor=1e-5, tol=1e-10)
    difference = task.mixture.covariances - once.covariances
    torch.testing.assert_close(difference, 1e-5 * torch.eye(4).double().expand(4, 4, 4), rtol=0, atol=1e-11)
    assert task.policy().n_components == 4


@pytest.mark.parametrize("shape", ["N", "P"])
def test_the_released_problem_without_data_says_what_to_give(shape):
    task = tasks.make("via_point", shape=shape, convention="released")
    message = r"via_point with convention='released' has no demonstrations.*give demonstrations=PATH or mixture=PATH"
    for use in (task.policy, lambda: task.mixture, lambda: task.demonstrations):
        with pytest.raises(InvalidArgumentError, match=message):
            use()
    assert tasks.make("via_point", convention="released", mixture=synthetic_mixture()).source is None


def test_costs_by_steps_add_up_to_the_cost():
    task = tasks.make("via_point", shape="P")
    policy = task.policy().expand(2)
    with torch.no_grad():
        policy.b[1] += 0.05
        path = task.rollout(policy)
    by_steps = task.step_costs(path)
    assert by_steps.shape == (2, 200)
    torch.testing.assert_close(by_steps.sum(-1), task.cost(path), rtol=1e-12, atol=0)
    v = path.v.numpy()
    expected = [[1e-4 * np.linalg.norm(v[r, j] - v[r, j - 1]) if j else 0.0 for j in range(199)] for r in range(2)]
    np.testing.assert_allclose(by_steps[:, :-1], expected, rtol=1e-10)
