import numpy as np
import pytest
import torch

import tasks
from torchds import GaussianMixture
from torchds.errors import InvalidArgumentError
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


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "initial", "bound"), [("N", 3.1, 0.20), ("P", 4.4, 0.60)])
def test_with_the_papers_settings_the_median_of_20_runs_passes_the_via_points(shape, initial, bound):
    task = tasks.make("via_point", shape=shape)
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    assert sum(terms.values()) == pytest.approx(initial, abs=0.05)
    assert path.x.shape == (201, 2)
    assert learn(task, 20, seed=0).median() <= bound


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_control_term_of_a_changed_policy_is_its_squared_deviation():
    task = tasks.make("via_point", shape="P")
    policy = task.policy()
    with torch.no_grad():
        policy.A += 0.01
        _, terms = task.evaluate(policy)
    assert float(terms["control"]) == pytest.approx(0.5 * 5e-4 * 200 * 16 * 0.01**2, rel=1e-9)


@pytest.mark.slow
def test_terms_have_the_shape_of_the_batch_of_policies():
    task = tasks.make("via_point")
    policy = task.policy().expand(3, 2)
    terms = task.cost_terms(task.rollout(policy))
    assert all(value.shape == (3, 2) for value in terms.values())


@pytest.mark.slow
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


@pytest.mark.slow
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
        ({"shapes": "N"}, InvalidArgumentError, "has no option shapes; it has shape, system, demonstrations"),
    ],
)
def test_wrong_options_are_refused(options, error, words):
    with pytest.raises(error, match=words):
        tasks.make("via_point", **options)


@pytest.mark.slow
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


@pytest.mark.parametrize("shape", ["N", "P"])
@pytest.mark.slow
def test_a_primitive_imitates_the_letter_with_as_many_parameters(shape):
    task, other = tasks.make("via_point", shape=shape, system="dmp"), tasks.make("via_point", shape=shape)
    primitive, system = task.policy(), other.policy()
    free = [sum(p.numel() for p in policy.parameters() if p.requires_grad) for policy in (primitive, system)]
    assert free == [24, 24]
    mean = torch.stack([d.x for d in task.demonstrations]).mean(0)
    away = [(path.x[:200] - mean).norm(dim=-1).mean() for path in (task.rollout(primitive), other.rollout(system))]
    assert away[0] < 0.2 and away[0] < away[1]


def test_a_primitive_needs_demonstrations_and_the_papers_convention():
    mixture = tasks.make("via_point").mixture
    with pytest.raises(InvalidArgumentError, match="fitted to demonstrations, got a mixture alone"):
        tasks.make("via_point", system="dmp", mixture=mixture).policy()
    with pytest.raises(InvalidArgumentError, match="'dmp' with convention 'paper', got 'dmp' and 'released'"):
        tasks.make("via_point", system="dmp", convention="released")
